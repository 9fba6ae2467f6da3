"""Expected seconds against measured ones: one thread, or two idle threads, which take 0.64 of it (`SERIAL_CHAPTER`)."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatreel.config import Config, Quality, preset
from splatreel.config.settings import FORMER_DEFAULTS, changed
from splatreel.run.costs import COSTS, Workload, chapter_plan, facing, scene_plan, sequence_plan
from splatreel.run.estimate import (
    SERIAL_CHAPTER,
    Division,
    chapters_time,
    divide,
    estimate,
    job_time,
    moving_share,
)
from splatreel.run.job import Plan
from splatreel.run.machine_speed import MachineSpeed
from splatreel.run.requirements import needed_memory
from splatreel.run.steps import STEPS
from splatreel.scene.camera import Camera
from splatreel.scene.group import chapter_spans, group_spans
from tests.method.captures import WallCapture
from tests.method.small import small


def a_run(frames: int, device: str = "cpu", chapter_frames: int = 300) -> Any:
    """Return a stand-in of a run."""
    config, groups = small({"group.length": 30, "group.overlap": 5}), group_spans(frames, 30, 5)
    return SimpleNamespace(
        capture=WallCapture(frames),
        config=config,
        device_name=device,
        gpu=None,
        groups=groups,
        chapters=chapter_spans(groups, chapter_frames),
    )


def seconds(run: Any, workers: int = 1, threads: int = 1, speed: MachineSpeed = MachineSpeed()) -> float:  # noqa: B008
    return estimate(run, Division(workers, threads), speed, 0.1).total


def test_threads_and_slow_machines() -> None:
    one = seconds(a_run(60))
    assert seconds(a_run(60), threads=2) == pytest.approx(0.64 * one)
    assert 0.4 * one < seconds(a_run(60), threads=4) < 0.5 * one
    assert seconds(a_run(60), speed=MachineSpeed(3.0, 3.0, 3.0)) == pytest.approx(3 * one)


def test_training_speed_depends_on_image_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Images of more than `Config.training_megapixels` are mostly trained at a smaller size."""
    speed, found = MachineSpeed(2.0, 4.0, 1.0), []
    for megapixels in (0.01, 0.23, 0.7, 4.0):
        for side in ("width", "height"):
            monkeypatch.setattr(WallCapture, side, round(1000 * megapixels**0.5))
        known, slower = (estimate(a_run(60), Division(1, 1), some, 0.1).seconds for some in (MachineSpeed(), speed))
        assert slower["encode"] == known["encode"]
        assert slower["group"] / known["group"] == pytest.approx(slower["keyframe"] / known["keyframe"])
        found.append(slower["group"] / known["group"])
    assert found[0] == pytest.approx(2.0)
    assert 2.0 < found[1] < found[2] < 4.0
    assert found[3] == pytest.approx(found[2], rel=1e-3)


def test_workers_need_less_time_and_more_memory() -> None:
    run = a_run(3000)
    one = estimate(run, Division(1, 4), MachineSpeed(), 0.1)
    four = estimate(run, Division(4, 1), MachineSpeed(), 0.1)
    assert one.total / 2.5 < four.total < one.total
    assert one.memory == needed_memory(run.capture, run.config)
    assert 4 * one.memory < four.memory < 5.5 * one.memory
    assert seconds(a_run(3000), 4) == seconds(a_run(3000), 3) * 3 / 4 or seconds(a_run(3000), 4) < seconds(
        a_run(3000), 3
    )


def test_gpu_training_time_is_independent_of_threads() -> None:
    speed, run = MachineSpeed(0.1, 0.1, 1.0), a_run(60, "cuda")
    cpu = estimate(a_run(60), Division(1, 1), MachineSpeed(), 0.1).seconds
    for threads in (1, 4):
        found = estimate(run, Division(1, threads), speed, 0.1).seconds
        assert found["group"] == pytest.approx(0.1 * cpu["group"])
    chaptered = a_run(3000, "cuda")
    few, many = (estimate(chaptered, Division(1, threads), speed, 0.1).seconds for threads in (1, 8))
    assert few["group"] == pytest.approx(many["group"])
    assert few["tracking"] > 2 * many["tracking"]


def test_moving_share_is_measured_on_few_images() -> None:
    still, quick = moving_share(WallCapture(9, speed=0.0), 9), moving_share(WallCapture(9, speed=0.2), 9)
    assert still == 0
    assert 0.05 < quick < 0.9
    assert moving_share(WallCapture(1), 1) == 0
    estimated = [
        estimate(a_run(30), Division(1, 1), MachineSpeed()),
        estimate(a_run(30), Division(1, 1), MachineSpeed(), 0),
    ]
    assert estimated[0].total > estimated[1].total
    assert estimated[0].moving > 0


def test_cameras_that_look_the_same_way() -> None:
    assert facing(WallCapture(1, cameras=3).cameras) > 0.9
    ahead = np.eye(4)
    back = np.diag([-1.0, 1.0, -1.0, 1.0])
    assert facing([Camera(str(k), view, np.eye(3), 4, 4) for k, view in enumerate((ahead, back))]) == 0


TWO_THREADS = 0.64
QUICK_PAPER = {"keyframe.first_iterations": 1000, "keyframe.refine_iterations": 250, "group.iterations_per_frame": 20}
UNTRIED = {"check_coverage": False}
MEASURED = {
    # megapixels, training cameras, share that moves, how far they look one way, frames, quality, settings, seconds of one thread
    "basketball 160x90": (0.0144, 27, 0.12, 0.35, 10, "standard", {}, 51.6),
    "basketball 160x90, paper": (0.0144, 27, 0.12, 0.35, 10, "paper", QUICK_PAPER, 44.4),
    "basketball 320x180, draft": (0.0576, 27, 0.12, 0.35, 10, "draft", {}, 73.6),
    "basketball 320x180": (0.0576, 27, 0.2, 0.35, 60, "standard", {}, 217 / TWO_THREADS),  # 3a19254
    "basketball 640x360": (0.2304, 27, 0.2, 0.35, 60, "standard", {}, 733.8),  # de618e4
    "built-in 256x192": (0.049152, 12, 0.2, 0.96, 60, "standard", {}, 225 / TWO_THREADS),  # a798874
    "yard 400x225": (0.09, 10, 0.141, 0.73, 40, "standard", {}, 248.2),  # 0c612b2
    "studio 320x180": (0.0576, 17, 0.377, 0.56, 45, "standard", {}, 343.2),  # de618e4
    "juggle 320x180": (0.0576, 26, 0.128, 0.29, 60, "standard", {}, 322.9),  # de618e4
    "hearth 336x252": (0.084672, 16, 0.134, 0.99, 45, "standard", {}, 390.2),  # de618e4
    "built-in 160x90, draft": (0.0144, 12, 0.204, 0.96, 30, "draft", {}, 60.1),
    "kitchen 1352x1014": (1.370928, 17, 0.034, 0.99, 10, "standard", {}, 388 / TWO_THREADS),
    "kitchen 728x546, draft": (0.397488, 8, 0.034, 0.99, 6, "draft", UNTRIED, 173.4),  # ec91c6c
    "kitchen 1352x1014, draft": (1.370928, 8, 0.034, 0.99, 6, "draft", UNTRIED, 396.9),  # d76ba1f
    "kitchen 2576x1932, draft": (4.976832, 8, 0.034, 0.99, 6, "draft", UNTRIED, 662.5),  # 7914854
    "flame_steak 1345x1008": (1.35576, 20, 0.0, 0.94, 1, "standard", {}, 669.6),
}
"""Of `benchmarks/results.jsonl` at the revision named, or measured when this was written; processor time without compiling."""
FORMER_COST = {"layering": 3.4, "tracking": 2.0, "first keyframe": 1.25, "keyframe": 1.25}
"""Time of stages at those revisions, as a multiple of today's: optical flow ended at full size, light took more passes, and keyframes
were trained with autograd."""


def total(work: Workload, frames: int, config: Config = Config()) -> float:  # noqa: B008 - it is frozen
    return sum(sequence_plan(work, group_spans(frames, 30, 5), config.for_video(frames)).seconds.values())


def former_total(seconds: dict[str, float]) -> float:
    """Return the sum of the seconds of all stages at the measured revisions."""
    return sum(seconds[stage] * FORMER_COST.get(stage, 1.0) for stage in seconds)


@pytest.mark.parametrize("name", MEASURED)
def test_seconds_match_measurements(name: str) -> None:
    *work, frames, quality, settings, seconds = MEASURED[name]
    former = {name: FORMER_DEFAULTS[name] for name in ("keyframe.first_iterations", "keyframe.coarse_share")}
    config = changed(preset(quality), settings | (former if quality == "standard" else {})).for_video(frames)
    said = former_total(sequence_plan(Workload(*work), group_spans(frames, 30, 5), config).seconds)
    assert 0.7 <= said / seconds <= 1.3


def test_motion_stages_match_measurements() -> None:
    """A group of the built-in capture: layering, and tracking by the seconds per frame of a half group, on one idle thread."""
    found = sequence_plan(Workload(0.049152, 12, 0.15, 0.96), group_spans(35, 30, 5), Config()).seconds
    assert 0.7 <= found["layering"] / 1.8 <= 1.3
    assert 0.7 <= found["tracking"] / 17.3 <= 1.3


def test_more_work_takes_more_seconds() -> None:
    usual = total(Workload(0.1, 10, 0.1, 0.5), 60)
    assert usual < total(Workload(0.2, 10, 0.1, 0.5), 60) < 2 * usual
    assert usual < total(Workload(0.1, 20, 0.1, 0.5), 60) < 2 * usual
    assert usual < total(Workload(0.1, 10, 0.2, 0.5), 60) < 2 * usual
    assert usual < total(Workload(0.1, 10, 0.1, 1.0), 60) < 1.5 * usual
    # Beyond the most iterations.
    first, second, third = (total(Workload(0.1, 10, 0.1, 0.5), frames) for frames in (600, 1200, 1800))
    assert third - second == pytest.approx(second - first)
    draft, standard, paper = (
        total(Workload(0.1, 10, 0.1, 0.5), 60, preset(name)) for name in ("draft", "standard", "paper")
    )
    assert draft < standard / 1.5
    assert paper > 5 * standard


def test_single_frame_has_no_motion_stages() -> None:
    found = sequence_plan(Workload(0.1, 10, 0.1, 0.5), group_spans(1, 30, 5), Config()).seconds
    assert {"layering", "tracking", "group"}.isdisjoint(found)


def test_chapter_seconds_match_long_video() -> None:
    """`benchmarks/long.py`: 205 s a chapter of 300 frames, the median of twenty, on two threads."""
    quick = {"keyframe.refine_iterations": 100, "group.iterations_per_frame": 6}
    config, spans = changed(preset("draft"), quick), group_spans(305, 30, 5)
    said = former_total(chapter_plan(Workload(0.0144, 5, 0.194, 0.96), spans, config).seconds)
    assert 0.7 <= said * TWO_THREADS / 205 <= 1.3


def test_chapters_add_scene_and_first_keyframes() -> None:
    work, spans, config = Workload(0.1, 10, 0.1, 0.5), group_spans(300, 30, 5), Config()
    scene, chapter = scene_plan(work, config).seconds, chapter_plan(work, tuple(spans), config).seconds
    sequence = sequence_plan(work, spans, config).seconds
    assert chapter["group"] == sequence["group"]
    assert "group" not in scene
    whole = sum(sequence.values())
    assert whole < sum(scene.values()) + sum(chapter.values()) < 1.3 * whole


WORK = Workload(0.1, 10, 0.1, 0.5)


def test_seconds_of_plan_are_those_of_its_steps_and_of_reading() -> None:
    spans, config = group_spans(100, 30, 5), Config()
    for plan in (sequence_plan(WORK, spans, config), chapter_plan(WORK, spans, config)):
        assert plan.total == pytest.approx(sum(plan.seconds.values()) - plan.seconds["reading"])
    plan = scene_plan(WORK, config)
    assert plan.total == pytest.approx(sum(plan.seconds.values()))


def test_steps_with_costs_are_known_and_planned() -> None:
    spans, config = group_spans(100, 30, 5), Config()
    plans = sequence_plan(WORK, spans, config), chapter_plan(WORK, spans, config), scene_plan(WORK, config)
    assert {step for plan in plans for step, *_ in plan.steps} == set(COSTS) <= set(STEPS)
    shown = {name for name, step in STEPS.items() if step.text}
    assert shown < set(COSTS), "the progress display needs the share of a step that it shows"


def test_step_without_text_is_added_to_the_next_one() -> None:
    plan = Plan((("points", None, 1.0), ("poses", 0, 2.0), ("keyframe", 0, 1.0)))
    assert plan.share("points", None) == (0.0, 0.25)
    assert plan.share("keyframe", 0) == (0.25, 1.0)


@given(st.integers(1, 400), st.sampled_from(["draft", "standard", "paper"]))
def test_shares_follow_each_other_and_fill_the_job(frames: int, quality: Quality) -> None:
    spans = group_spans(frames, 30, 5)
    plan = sequence_plan(WORK, spans, preset(quality))
    shares = [plan.share(step, group) for step, group, _ in plan.steps if STEPS[step].text]
    assert shares[0] == plan.share("points", None)
    assert shares[0][0] == 0
    assert shares[-1][1] == pytest.approx(1)
    for before, after in pairwise(shares):
        assert before[0] <= before[1] == pytest.approx(after[0])


def test_more_iterations_are_a_larger_share() -> None:
    def share(iterations: int) -> float:
        config = changed(Config(), {"group.iterations_per_frame": iterations})
        begin, end = sequence_plan(WORK, group_spans(30, 30, 5), config).share("motion", 0)
        return end - begin

    assert share(100) < share(200) < share(400)


def test_share_of_missing_group_is_an_error() -> None:
    with pytest.raises(KeyError):
        sequence_plan(WORK, group_spans(30, 30, 5), Config()).share("motion", 1)


def test_threads_speed_up_only_the_parallel_share() -> None:
    assert job_time(100.0, 0.2, 1) == 100.0
    assert job_time(100.0, 0.2, 4) == pytest.approx(20 + 80 / 4)


def test_chapters_are_made_in_rounds() -> None:
    one = job_time(1.0, SERIAL_CHAPTER, 4)
    assert chapters_time(1.0, 8, Division(4, 4)) == pytest.approx(2 * one)
    assert chapters_time(1.0, 9, Division(4, 4)) == pytest.approx(3 * one)


def test_machine_is_divided_by_its_cores_its_memory_and_the_chapters() -> None:
    assert divide(1, 20) == Division(1, 1)
    assert divide(16, 1) == Division(1, 16)
    assert divide(16, 20, most=3).workers <= 3
    for cores in range(1, 33):
        for chapters in range(1, 12):
            found = divide(cores, chapters)
            assert found.workers * found.threads <= cores
            assert found.workers <= chapters
            times = [chapters_time(1.0, chapters, Division(w, cores // w)) for w in range(1, min(cores, chapters) + 1)]
            assert chapters_time(1.0, chapters, found) <= 1.15 * min(times)
