"""Settings of keyframes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from splatreel.config.setting_values import Count, Range, Share, Weight, check

FEWEST_ITERATIONS, MOST_ITERATIONS = 1000, 4000
"""Range of the iterations of a first keyframe that the number of frames decides."""
ITERATIONS_PER_FRAME = 7.5
"""Iterations of a first keyframe that each frame of the video adds. They take a tenth to a fifth of all time, at any length."""


@dataclass(frozen=True)
class KeyframeConfig:
    """Settings of the static reconstruction of a group's first frame (3DGS, paper section 5.1)."""

    first_iterations: Annotated[int, Range(0)] = 0
    """Iterations of the first keyframe, which starts from sparse points. 0 decides by the number of frames: its static points are
    stored once, so a longer video affords better ones."""
    refine_iterations: Count = 400
    """Iterations of later keyframes, which start from the last group."""
    coarse_share: Share = 0.35
    """Share of the iterations of the first keyframe that use half-size images."""
    temporal_mean: bool = True
    """Train on the mean of the group's images where nothing moves, which has less noise."""
    rate_scale: Annotated[float, Range(1e-3)] = 4.0
    """Factor on the learning rates of 3DGS, which are for 30,000 iterations. The higher SH bands keep theirs."""
    far_step_scale: Annotated[float, Range(1)] = 8.0
    """Largest factor on the position steps of points beyond the typical viewing distance."""
    sh_degree: Annotated[int, Range(0, 3)] = 3
    """Degree of the spherical harmonics of view-dependent color."""
    max_points: Count = 60_000
    """Maximum number of points of the first keyframe."""
    points_per_pixel: Weight = 0.6
    """Maximum number of points per pixel of one image. Small images cannot tell more points apart."""
    lambda_opacity: Weight = 0.01
    """Weight of opacities after densification, per pixel of an image, so that points that explain little fade."""
    lambda_spread: Weight = 1.0
    """Weight of floaters: opacity in front of the surface that a pixel shows, by its distance in log depth."""
    lambda_roughness: Weight = 0.3
    """Weight of bends in depth where an image is plain. With few cameras, nothing else determines the distance of a wall."""
    detail: bool = True
    """Densify the first keyframe by absolute gradients, and add points in the pixels that differ most from the images."""
    densify_every: Count = 100
    """Iterations between two densifications."""
    average_share: Share = 0.1
    """Share of the iterations, the last ones, whose mean is kept instead of the last state."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "keyframe.")

    def for_video(self, frames: int) -> KeyframeConfig:
        """Return the settings for a video of a number of frames, 0 if it is not known: `first_iterations` is decided."""
        decided = min(round(FEWEST_ITERATIONS + ITERATIONS_PER_FRAME * frames), MOST_ITERATIONS)
        return replace(self, first_iterations=self.first_iterations or decided)
