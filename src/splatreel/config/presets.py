"""Presets of `--quality`: standard is `Config()`, the others are differences from it."""

from __future__ import annotations

from typing import Any, Literal

from splatreel.base.errors import UsageError
from splatreel.config.config import Config
from splatreel.config.settings import changed, settings

Quality = Literal["draft", "standard", "paper"]

DRAFT: dict[str, Any] = {
    "keyframe.first_iterations": 1000,
    "keyframe.coarse_share": 0.5,
    "keyframe.refine_iterations": 250,
    "keyframe.max_points": 30_000,
    "group.iterations_per_frame": 15,
}

SECTION_5_1: dict[str, Any] = {
    "keyframe.first_iterations": 20_000,
    "keyframe.refine_iterations": 5_000,
    "keyframe.rate_scale": 1.0,
    "layering.flow_frames": 1,
    "layering.segment": "grabcut",
    "layering.lift": "optimize",
    "group.iterations_per_frame": 400,
    "group.deformation": "hashgrid",
    "group.progressive_share": 0.5,
    "encode.codec": "h265",
}
"""Settings in which the paper (sections 4 and 5.1) differs from standard. Those of its Table 11 are the same."""

BEYOND_THE_PAPER: dict[str, Any] = {
    "layering.adapt_changed_share": 0.0,
    "layering.relighting": False,
    "keyframe.coarse_share": 0.0,
    "keyframe.detail": False,
    "keyframe.temporal_mean": False,
    "keyframe.far_step_scale": 1.0,
    "keyframe.max_points": 1_000_000,
    "keyframe.points_per_pixel": 2.0,
    "keyframe.lambda_opacity": 0.0,
    "keyframe.lambda_spread": 0.0,
    "keyframe.lambda_roughness": 0.0,
    "keyframe.average_share": 0.0,
    "group.coarse_share": 0.0,
    "group.tracks": False,
    "group.appearance": False,
    "group.time_offsets": False,
    "group.faint_share": 0.0,
    "group.lambda_sh": 0.0,
    "correct_colors": False,
    "check_poses": False,
    "check_coverage": False,
    "even_exposure": False,
    "antialias": False,
    "background": False,
    "training_megapixels": 0.0,
    "chapter_frames": 0,
}
"""Settings that turn off everything that the paper does not have."""

PRESETS: dict[Quality, dict[str, Any]] = {
    "draft": DRAFT,
    "standard": {},
    "paper": SECTION_5_1 | BEYOND_THE_PAPER,
}


def preset(quality: Quality) -> Config:
    """Return the settings of a quality.

    Raises:
        UsageError: There is no such quality.
    """
    if quality not in PRESETS:
        raise UsageError(f"Unknown quality {quality!r}. Choose draft, standard or paper.")
    return changed(Config(), PRESETS[quality])


def unusual_settings(config: Config) -> list[str]:
    """Return the names of settings whose value is that of no preset."""
    usual = [preset(quality) for quality in PRESETS]
    return [name for name, one in settings().items() if one.of(config) not in [one.of(other) for other in usual]]
