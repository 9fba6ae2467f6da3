"""Splatreel: volumetric video from many static cameras.

The public names below are imported on first use. `import splatreel` is therefore fast, and playing a reel does not
load what reconstruction needs. `splatreel.readers` has the parts of capture readers, and `splatreel.training` trains from arrays.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from splatreel.api import evaluate, reconstruct, render
    from splatreel.base.errors import CancelledError, SplatreelError
    from splatreel.capture.array_capture import capture_from_arrays
    from splatreel.capture.opening import open_capture
    from splatreel.codec.inspection import verify_reel
    from splatreel.config import Config, preset
    from splatreel.formats.ply import read_ply, write_ply
    from splatreel.play.player_page import copy_player
    from splatreel.play.timeline import open_reel
    from splatreel.scene.camera import Camera
    from splatreel.scene.gaussians import Gaussians

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "CancelledError",
    "Config",
    "Gaussians",
    "SplatreelError",
    "capture_from_arrays",
    "copy_player",
    "evaluate",
    "open_capture",
    "open_reel",
    "preset",
    "read_ply",
    "reconstruct",
    "render",
    "verify_reel",
    "write_ply",
]

_HOMES = {
    "Camera": "splatreel.scene.camera",
    "CancelledError": "splatreel.base.errors",
    "Config": "splatreel.config",
    "Gaussians": "splatreel.scene.gaussians",
    "SplatreelError": "splatreel.base.errors",
    "capture_from_arrays": "splatreel.capture.array_capture",
    "copy_player": "splatreel.play.player_page",
    "evaluate": "splatreel.api",
    "open_capture": "splatreel.capture.opening",
    "open_reel": "splatreel.play.timeline",
    "preset": "splatreel.config",
    "read_ply": "splatreel.formats.ply",
    "reconstruct": "splatreel.api",
    "render": "splatreel.api",
    "verify_reel": "splatreel.codec.inspection",
    "write_ply": "splatreel.formats.ply",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'splatreel' has no attribute {name!r}")
    from splatreel.base.process import quiet_threads

    quiet_threads()
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
