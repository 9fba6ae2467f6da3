"""Settings for tests that reconstruct: `standard` with few iterations, and the plain method of the paper."""

from typing import Any

from splatreel.config import Config
from splatreel.config.presets import BEYOND_THE_PAPER
from splatreel.config.settings import changed

FEW: dict[str, Any] = {
    "keyframe.first_iterations": 30,
    "keyframe.refine_iterations": 8,
    "keyframe.densify_every": 5,
    "keyframe.sh_degree": 1,
    "group.length": 2,
    "group.overlap": 1,
    "group.iterations_per_frame": 3,
    "layering.adapt_every": 4,
    "layering.flow_frames": 2,
    "check_coverage": False,
}
"""Few iterations and short groups. No trial of novel views is made: that is a reconstruction of its own."""


def small(changes: dict[str, Any] | None = None) -> Config:
    """Return the default settings with few iterations. Tracks, appearance, light, exposures and poses are enabled.

    changes: by name, as `group.length`.
    """
    return changed(Config(), FEW | (changes or {}))


def plain(changes: dict[str, Any] | None = None) -> Config:
    """Without anything that goes beyond the paper, for tests that look at one thing alone; colors are corrected, as in `standard`."""
    as_printed = {"keyframe.rate_scale": 1.0, "group.progressive_share": 0.5, "correct_colors": True}
    return changed(Config(), BEYOND_THE_PAPER | as_printed | (changes or {}))
