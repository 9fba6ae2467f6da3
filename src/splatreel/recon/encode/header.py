"""What a manifest says of a whole reel, before any of its files: from the rig, the layout and the settings."""

from __future__ import annotations

from typing import Any

import numpy as np

from splatreel.config import Config
from splatreel.recon.coverage.coverage import Coverage
from splatreel.recon.init.layout import Layout
from splatreel.recon.init.limits import limits
from splatreel.scene.camera import Camera


def header_of(
    cameras: list[Camera], fps: float, config: Config, layout: Layout, points: np.ndarray, coverage: Coverage | None
) -> dict[str, Any]:
    """Arguments of `ReelWriter`, and the limits.

    cameras: those that are trained on. points: [P, 3], the initial ones. coverage: None where nobody looked.
    """
    return {
        "fps": fps,
        "group_length": config.group.length,
        "overlap": config.group.overlap,
        "sh_degree": config.keyframe.sh_degree,
        "bounds": layout.bounds,
        "up": layout.up,
        "near": layout.near,
        "clearance": layout.clearance,
        "background": layout.background,
        "antialias": config.antialias,
        "camera": cameras[len(cameras) // 2],
        "cameras": cameras,
        "limits": limits(cameras, points, layout, None if coverage is None else coverage.angle),
    }
