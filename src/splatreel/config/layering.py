"""Settings of motion layering."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from splatreel.config.setting_values import Count, Needs, Range, Share, Weight, check

PAPER_WIDTH = 1352
"""Image width in pixels that the thresholds of flow and gradients refer to, as in the paper."""


SEPARATED = Needs("layering.enabled", (True,))
OPTIMIZED = Needs("layering.lift", ("optimize",))
ADAPTED = Needs("layering.adapt_every", but=(0,))


@dataclass(frozen=True)
class LayeringConfig:
    """Settings of motion layering (paper section 4.1): the separation of dynamic points from static points, which are stored once."""

    enabled: bool = True
    """Separate static from dynamic points; otherwise all points move, as in config. 1 of the paper's Table 8."""
    flow: Annotated[
        Literal["dis", "raft"], Needs("layering.enabled", (True,), other=Needs("group.tracks", (True,)))
    ] = "dis"
    """Optical flow: dis is part of OpenCV; raft needs weights that you provide."""
    segment: Annotated[Literal["grabcut", "sam2", "none"], SEPARATED] = "none"
    """Segmentation that completes motion masks to whole objects; sam2 needs weights that you provide."""
    flow_threshold: Annotated[Weight, SEPARATED] = 2.0
    """Flow in pixels, at a width of 1352, above which a pixel moves (lambda_raft)."""
    flow_frames: Annotated[Count, SEPARATED] = 7
    """Number of frames of the group that flow is computed to; the paper uses 1, the next keyframe."""
    lift: Annotated[Literal["optimize", "vote"], SEPARATED] = "vote"
    """Method that turns masks into labels of points: the paper's optimization of rendered labels, or votes by each point's share in
    the masks."""
    lambda_nn: Annotated[Weight, OPTIMIZED] = 0.5
    """Weight of different labels of neighbors, for lift `optimize` (lambda_seg^nn)."""
    lambda_dyn: Annotated[Weight, OPTIMIZED] = 0.3
    """Weight of static labels, for lift `optimize` (lambda_seg^dyn)."""
    adapt_every: Annotated[int, Range(0)] = 100
    """Iterations between two adaptive conversions of static points to dynamic ones; 0 turns off conversion, cloning and pruning."""
    adapt_gradient: Annotated[Weight, ADAPTED] = 3e-4
    """Mean gradient above which static points become dynamic (lambda_adp^grad), in normalized device units at a width of 1352.
    Splats of smaller images are larger and have larger gradients."""
    adapt_neighbors: Annotated[Weight, ADAPTED, SEPARATED] = 0.6
    """Share of dynamic neighbors above which static points become dynamic (lambda_adp^nn)."""
    adapt_changed_share: Annotated[Share, ADAPTED, SEPARATED] = 0.3
    """Share of a static point's visible area that must lie where images of the group change for the point to be converted. 0 converts
    anywhere, as the paper does."""
    relighting: Annotated[bool, SEPARATED] = True
    """Put static points whose light changes into the group, so that their colors can follow."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "layering.")
