"""Seconds that jobs are expected to take, stage by stage: for estimates, and for the progress display."""

from __future__ import annotations

from collections.abc import Sequence

from splatreel.config import Config
from splatreel.run.job import POINTS, Plan
from splatreel.run.preparation import POINTS_TEXT, points_seconds
from splatreel.run.shared_scene import SCENE_POINTS, SCENE_TEXT
from splatreel.run.stages.group_stages import GROUP_STAGES
from splatreel.run.stages.keyframe_stages import FirstKeyframe
from splatreel.run.stages.stage import FirstOfChapter, FirstOfVideo, NextGroup
from splatreel.run.workload import Seconds, Workload, sum_seconds
from splatreel.scene.spans import GroupSpan

READING = "reading"
READING_SECONDS = 0.015
"""Seconds to decode a megapixel."""

Step = tuple[str, int | None, float]


def sequence_plan(work: Workload, spans: Sequence[GroupSpan], config: Config) -> Plan:
    """Return the plan of a video of one chapter."""
    points = (POINTS_TEXT, None, points_seconds(work, config))
    return Plan((points, *_group_steps(work, spans, config, FirstOfVideo)))


def chapter_plan(work: Workload, spans: Sequence[GroupSpan], config: Config) -> Plan:
    """Return the plan of one chapter of a longer video."""
    return Plan(tuple(_group_steps(work, spans, config, FirstOfChapter)))


def scene_plan(work: Workload, config: Config) -> Plan:
    """Return the plan of the scene that all chapters share."""
    points = SCENE_POINTS * points_seconds(work, config)
    return Plan(((POINTS_TEXT, None, points), (SCENE_TEXT, None, FirstKeyframe().seconds(work, 0, config))))


def sequence_seconds(work: Workload, spans: Sequence[GroupSpan], config: Config) -> Seconds:
    """Return the seconds by stage of a video of one chapter."""
    return sum_seconds([{POINTS: points_seconds(work, config)}, _group_seconds(work, spans, config, FirstOfVideo)])


def chapter_seconds(work: Workload, spans: Sequence[GroupSpan], config: Config) -> Seconds:
    """Return the seconds by stage of one chapter of a longer video."""
    return _group_seconds(work, spans, config, FirstOfChapter)


def scene_seconds(work: Workload, config: Config) -> Seconds:
    """Return the seconds by stage of the scene that all chapters share."""
    keyframe = FirstKeyframe()
    points = SCENE_POINTS * points_seconds(work, config)
    return {POINTS: points, keyframe.name: keyframe.seconds(work, 0, config)}


def _group_steps(work: Workload, spans: Sequence[GroupSpan], config: Config, first: type) -> list[Step]:
    """Return the stages of groups in their order. `first`: the state that the first group starts with."""
    starts = [first, *(NextGroup for _ in spans[1:])]
    return [
        (stage.text, span.index, stage.seconds(work, span.count, config))
        for span, start in zip(spans, starts, strict=True)
        for stage in GROUP_STAGES
        if start in stage.starts
    ]


def _group_seconds(work: Workload, spans: Sequence[GroupSpan], config: Config, first: type) -> Seconds:
    """Return the seconds of groups by stage, and of reading their images."""
    starts = [first, *(NextGroup for _ in spans[1:])]
    parts = [
        {stage.name: seconds}
        for span, start in zip(spans, starts, strict=True)
        for stage in GROUP_STAGES
        if start in stage.starts and (seconds := stage.seconds(work, span.count, config))
    ]
    return sum_seconds([{READING: READING_SECONDS * work.decoded(span.count)} for span in spans] + parts)
