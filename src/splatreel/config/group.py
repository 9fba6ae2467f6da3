"""Settings of the reconstruction of a group."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from splatreel.config.values import Count, Range, Share, Weight, check
from splatreel.errors import UsageError


@dataclass(frozen=True)
class GroupConfig:
    """Group reconstruction, paper section 4.2: how dynamic points move from their keyframe on."""

    length: Count = 30
    """Frames of a group that are its own."""
    overlap: Annotated[int, Range(0)] = 5
    """Frames that a group shares with the next one, in which they fade into each other; fewer than length."""
    deformation: Literal["trajectory", "hashgrid"] = "trajectory"
    """How points move: each along a spline of its own, or by the paper's 4D hash grid."""
    iterations_per_frame: Count = 110
    """Iterations of a group for each of its frames, overlap included."""
    coarse_share: Share = 0.25
    """Share of the iterations that look at images of half size."""
    lambda_dssim: Share = 0.2
    """Weight of 1 - SSIM against the absolute difference of colors (lambda)."""
    lambda_arap: Weight = 0.01
    """Weight of as-rigid-as-possible motion (lambda_arap)."""
    lambda_temporal: Weight = 0.01
    """Weight of motion that is smooth over time (lambda_temp)."""
    tracks: bool = True
    """Start from tracks by optical flow, and from new points where several views lack something."""
    appearance: bool = True
    """Color and opacity of dynamic points change slowly within a group."""
    time_offsets: bool = True
    """Learn when each camera takes its images: rigs are seldom quite in step."""
    faint_share: Share = 0.01
    """Twice during training the faintest points are removed that together hold this share of all blending weight; 0 keeps all."""
    lambda_sh: Weight = 0.05
    """Weight of the sizes of the points' higher SH bands, summed and divided by the pixels of an image: each camera sees what moves
    in another pose, and how its color depends on the view is mostly noise."""
    progressive_share: Share = 0.0
    """Share of the iterations over which frames are let in one after the other; 0 turns progressive sampling off."""

    def __post_init__(self) -> None:
        check(self, "group.")
        if self.overlap >= self.length:
            raise UsageError(
                f"group.overlap {self.overlap} does not fit group.length {self.length}. "
                "Choose an overlap shorter than a group."
            )
