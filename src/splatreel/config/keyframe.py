"""Settings of the reconstruction of a keyframe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from splatreel.config.values import Count, Range, Share, Weight, check


@dataclass(frozen=True)
class KeyframeConfig:
    """Static reconstruction of a group's first frame: 3DGS, paper section 5.1."""

    first_iterations: Count = 2000
    """Iterations of the first keyframe, which starts from sparse points."""
    refine_iterations: Count = 400
    """Iterations of later keyframes, which start from the group before."""
    coarse_share: Share = 0.5
    """Share of the iterations of the first keyframe that look at images of half size."""
    temporal_mean: bool = True
    """Train on the mean of the group's images where nothing moves: less noise is learned by heart."""
    rate_scale: Annotated[float, Range(1e-3)] = 4.0
    """Learning rates in multiples of those of 3DGS, which are for 30,000 iterations; the higher SH bands keep theirs."""
    far_step_scale: Annotated[float, Range(1)] = 8.0
    """Points farther than the typical viewing distance move in larger steps, up to this many times."""
    sh_degree: Annotated[int, Range(0, 3)] = 3
    """Degree of the spherical harmonics of view-dependent color."""
    max_points: Count = 60_000
    """Most points of the first keyframe."""
    points_per_pixel: Weight = 0.6
    """Never more points than this many for each pixel of one image: small images cannot tell more apart."""
    lambda_opacity: Weight = 0.01
    """Weight of opacities once densification is over, summed and divided by the pixels of an image: what explains little fades."""
    lambda_spread: Weight = 1.0
    """Weight of what lies before the surface that a pixel shows, by its distance in log depth: floaters fade."""
    lambda_roughness: Weight = 0.3
    """Weight of bends in depth where an image is plain: with few cameras, nothing else says how far a wall is."""
    densify_every: Count = 100
    """Iterations between two densifications."""
    average_share: Share = 0.1
    """Share of the iterations, the last ones, whose mean is kept in place of where the last one ended."""

    def __post_init__(self) -> None:
        check(self, "keyframe.")
