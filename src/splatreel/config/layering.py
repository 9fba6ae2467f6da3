"""Settings of motion layering."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from splatreel.config.values import Count, Range, Share, Weight, check

PAPER_WIDTH = 1352
"""Image width, in pixels, that the thresholds of flow and of gradients are for, as in the paper."""


@dataclass(frozen=True)
class LayeringConfig:
    """Motion layering, paper section 4.1: which points move, and which rest and are stored once."""

    flow: Literal["dis", "raft"] = "dis"
    """Optical flow: dis comes with OpenCV, raft needs weights that you bring."""
    segment: Literal["grabcut", "sam2", "none"] = "none"
    """What completes motion masks to whole objects; sam2 needs weights that you bring."""
    flow_threshold: Weight = 2.0
    """Flow longer than this many pixels, at a width of 1352, is motion (lambda_raft)."""
    flow_frames: Count = 7
    """Frames of the group that flow is computed to; the paper uses 1, the next keyframe."""
    lift: Literal["optimize", "vote"] = "vote"
    """How masks become labels of points: by the paper's optimization of rendered labels, or by what each point adds to masks."""
    lambda_nn: Weight = 0.5
    """Of lift `optimize`: weight of neighbors that are labeled differently (lambda_seg^nn)."""
    lambda_dyn: Weight = 0.3
    """Of lift `optimize`: weight of points that are labeled static (lambda_seg^dyn)."""
    adapt_every: Annotated[int, Range(0)] = 100
    """Iterations between two adaptive conversions of static points to dynamic ones; 0 turns off conversion, cloning and pruning."""
    adapt_gradient: Weight = 3e-4
    """Static points that images pull at by more than this become dynamic (lambda_adp^grad): mean gradient in normalized device
    units, at a width of 1352. In smaller images splats are larger and pull harder."""
    adapt_neighbors: Weight = 0.6
    """Static points with more than this share of dynamic neighbors become dynamic (lambda_adp^nn)."""
    adapt_changed_share: Share = 0.3
    """Only static points are converted that show this share of what they show where images of the group change; 0 converts
    anywhere, as the paper does."""
    relighting: bool = True
    """Points that rest while their light changes belong to the group too, so that their colors can follow."""

    def __post_init__(self) -> None:
        check(self, "layering.")
