"""Plans of jobs: their steps, and the seconds that each is expected to take."""

from __future__ import annotations

from collections.abc import Sequence

from splatreel.config import Config
from splatreel.run.costs import COSTS, READING_SECONDS, SCENE_POINTS, Workload
from splatreel.run.job import Plan
from splatreel.scene.group import GroupSpan

BEFORE_KEYFRAME, AFTER_KEYFRAME = ("exposure", "poses"), ("layering", "layer", "tracking", "motion", "encode")
"""Steps of every group."""


def sequence_plan(work: Workload, spans: Sequence[GroupSpan], config: Config) -> Plan:
    """Return the plan of a video of one chapter."""
    groups = _groups_plan(work, spans, config, "first keyframe")
    return Plan((("points", None, COSTS["points"](work, 1, config)), *groups.steps), groups.reading)


def chapter_plan(work: Workload, spans: Sequence[GroupSpan], config: Config) -> Plan:
    """Return the plan of one chapter of a longer video."""
    return _groups_plan(work, spans, config, "chapter keyframe")


def scene_plan(work: Workload, config: Config) -> Plan:
    """Return the plan of the scene that all chapters share."""
    points = SCENE_POINTS * COSTS["points"](work, 1, config)
    return Plan((("points", None, points), ("scene keyframe", None, COSTS["scene keyframe"](work, 0, config))))


def _groups_plan(work: Workload, spans: Sequence[GroupSpan], config: Config, first: str) -> Plan:
    """Return the plan of groups. `first`: step that trains the keyframe of the first group."""
    keyframes = [first, *("keyframe" for _ in spans[1:])]
    steps = [
        (step, span.index, COSTS[step](work, span.count, config))
        for span, keyframe in zip(spans, keyframes, strict=True)
        for step in (*BEFORE_KEYFRAME, keyframe, *AFTER_KEYFRAME)
    ]
    return Plan(tuple(steps), sum(READING_SECONDS * work.decoded(span.count) for span in spans))
