"""Splatreel: volumetric video from many static cameras.

The public names below are imported on first use. `import splatreel` is therefore fast, and playing a reel does not
import torch.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from splatreel.capture.opening import open_capture
    from splatreel.config import Config, preset
    from splatreel.evaluation.evaluate import evaluate
    from splatreel.kernels.image import render_image as render
    from splatreel.play.timeline import open_reel
    from splatreel.recon.pipeline import reconstruct
    from splatreel.scene.camera import Camera
    from splatreel.scene.gaussians import Gaussians

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "Config",
    "Gaussians",
    "evaluate",
    "open_capture",
    "open_reel",
    "preset",
    "reconstruct",
    "render",
]

_HOMES = {
    "Camera": ("splatreel.scene.camera", "Camera"),
    "Config": ("splatreel.config", "Config"),
    "Gaussians": ("splatreel.scene.gaussians", "Gaussians"),
    "evaluate": ("splatreel.evaluation.evaluate", "evaluate"),
    "open_capture": ("splatreel.capture.opening", "open_capture"),
    "open_reel": ("splatreel.play.timeline", "open_reel"),
    "preset": ("splatreel.config", "preset"),
    "reconstruct": ("splatreel.recon.pipeline", "reconstruct"),
    "render": ("splatreel.kernels.image", "render_image"),
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'splatreel' has no attribute {name!r}")
    module, attribute = _HOMES[name]
    return getattr(importlib.import_module(module), attribute)
