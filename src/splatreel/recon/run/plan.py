"""How much of a whole reconstruction each stage is, so that progress can tell the time left of all of it."""

from __future__ import annotations

from collections.abc import Sequence

from splatreel.config import Config
from splatreel.progress import Span
from splatreel.scene.spans import GroupSpan

MOTION_COST = 0.7
"""Seconds of an iteration of motion over those of an iteration of a keyframe, roughly: most of the picture stands still."""
COARSE_COST = 0.5
POINTS_COST = 200.0
LAYERING_COST = 350.0
"""Initial points and layering, in iterations of a keyframe."""
TRACKING_COST = 50.0
"""Tracking a frame, in iterations of a keyframe."""


class Plan:
    """The stages of a job in their order, with what each costs beside the others.

    spans: its groups; the first one trains all points. Costs are estimates: what moves decides the rest.
    """

    def __init__(self, spans: Sequence[GroupSpan], config: Config) -> None:
        keyframe, motion = config.keyframe, config.group
        first = keyframe.first_iterations * _cost(keyframe.coarse_share)
        each = MOTION_COST * motion.iterations_per_frame * _cost(motion.coarse_share)
        self._costs = {"points": POINTS_COST}
        for place, span in enumerate(spans):
            group, count = span.index, span.count
            self._costs[f"keyframe {group}"] = keyframe.refine_iterations if place else first
            self._costs[f"layering {group}"] = LAYERING_COST
            self._costs[f"tracking {group}"] = TRACKING_COST * count if motion.tracks else 0.0
            self._costs[f"motion {group}"] = each * count

    @property
    def total(self) -> float:
        """What all of it costs, in iterations of a keyframe."""
        return sum(self._costs.values())

    def points(self) -> Span:
        return self._span("points")

    def keyframe(self, group: int) -> Span:
        return self._span(f"keyframe {group}")

    def layering(self, group: int) -> Span:
        return self._span(f"layering {group}")

    def tracking(self, group: int) -> Span:
        return self._span(f"tracking {group}")

    def motion(self, group: int) -> Span:
        return self._span(f"motion {group}")

    def layered(self, group: int) -> Span:
        """When layering is over: writing takes no time to speak of beside it."""
        _, end = self.layering(group)
        return end, end

    def moved(self, group: int) -> Span:
        """When motion is."""
        _, end = self.motion(group)
        return end, end

    def _span(self, stage: str) -> Span:
        """The part of the whole job a stage is: where it starts and ends, 0..1."""
        total, begin = self.total, 0.0
        for name, cost in self._costs.items():
            if name == stage:
                return begin / total, (begin + cost) / total
            begin += cost
        raise KeyError(stage)


def _cost(coarse_share: float) -> float:
    """Of training of which so much is at half size, as a share of what all of it would cost at full size."""
    return 1 - coarse_share * (1 - COARSE_COST)
