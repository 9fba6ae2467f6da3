"""Settings of the motion of a group."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from splatreel.base.errors import UsageError
from splatreel.config.setting_values import Count, Needs, Range, Share, Weight, check

Deformation = Literal["trajectory", "hashgrid"]


@dataclass(frozen=True)
class GroupConfig:
    """Settings of the motion of dynamic points within a group (paper section 4.2)."""

    length: Count = 30
    """Frames of a group without the overlap."""
    overlap: Annotated[int, Range(0)] = 5
    """Frames that a group shares with the next one, in which the two cross-fade; less than length."""
    deformation: Deformation = "trajectory"
    """Model of motion: a spline for each point, or the paper's 4D hash grid."""
    iterations_per_frame: Count = 110
    """Training iterations for each frame of the group, overlap included."""
    coarse_share: Share = 0.25
    """Share of the iterations that use half-size images."""
    lambda_dssim: Share = 0.2
    """Weight of 1 - SSIM against the absolute color difference (lambda)."""
    lambda_arap: Weight = 0.01
    """Weight of as-rigid-as-possible motion (lambda_arap)."""
    lambda_temporal: Weight = 0.01
    """Weight of smooth motion over time (lambda_temp)."""
    tracks: bool = True
    """Start from optical flow tracks, and add points where several views show something new."""
    appearance: bool = True
    """Let color and opacity of dynamic points change slowly within a group."""
    time_offsets: bool = True
    """Learn by how many frames each camera is late."""
    faint_share: Share = 0.01
    """Share of all blending weight. Twice during training, the faintest points that hold this share together are removed. 0 keeps
    all."""
    lambda_sh: Annotated[Weight, Needs("keyframe.sh_degree", but=(0,))] = 0.05
    """Weight of the higher SH bands' magnitude, per pixel of an image. These bands learn mostly noise on moving things, which show
    each camera another pose."""
    progressive_share: Share = 0.0
    """Share of the iterations over which frames are added one by one; 0 uses all frames from the start."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "group.")
        if self.overlap >= self.length:
            raise UsageError(
                f"group.overlap {self.overlap} does not fit group.length {self.length}. "
                "Choose an overlap shorter than a group."
            )
