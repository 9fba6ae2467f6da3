"""Settings of keyframes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from splatreel.config.values import Count, Range, Share, Weight, check


@dataclass(frozen=True)
class KeyframeConfig:
    """Settings of the static reconstruction of a group's first frame (3DGS, paper section 5.1)."""

    first_iterations: Count = 2000
    """Iterations of the first keyframe, which starts from sparse points."""
    refine_iterations: Count = 400
    """Iterations of later keyframes, which start from the last group."""
    coarse_share: Share = 0.5
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
    densify_every: Count = 100
    """Iterations between two densifications."""
    average_share: Share = 0.1
    """Share of the iterations, the last ones, whose mean is kept instead of the last state."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "keyframe.")
