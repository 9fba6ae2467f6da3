"""Jobs of a batch system, at the same time, in any order, and repeated."""

from __future__ import annotations

import json
import multiprocessing
import re
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from splatreel.base import threads
from splatreel.base.errors import ReconstructionError, UsageError
from splatreel.base.progress import Silent
from splatreel.config.settings import changed
from splatreel.run.machines.batch import run_job
from splatreel.run.machines.share import JobName, Share, parse_share, share_of_task
from splatreel.run.output.group_writer import no_presentation
from splatreel.run.pipeline import RunSpec
from tests.method.captures import WallCapture
from tests.run.machines.runs import CONFIG, spec
from tests.run.test_pipeline import content


def job(run: RunSpec, name: JobName, share: Share | None = None) -> str:
    return run_job(run, name, share, Silent(), no_presentation)


def read_status(out: Path) -> dict[str, Any]:
    return json.loads((out / "status.json").read_text())


def task(out: Path, index: int) -> None:
    """Run one of two tasks on a machine of its own."""
    threads.use(1)
    job(spec(out), "chapter", Share(index, 2))


@pytest.mark.slow
def test_two_tasks_at_once_make_the_reel_that_one_process_makes(out: Path, expected: dict[str, str]) -> None:
    context = multiprocessing.get_context("spawn")
    tasks = [context.Process(target=task, args=(out, index)) for index in range(2)]
    for each in tasks:
        each.start()
    with pytest.raises(ReconstructionError, match="3 of 3 chapters are not finished"):
        job(spec(out), "finish")
    for each in tasks:
        each.join()
    assert [each.exitcode for each in tasks] == [0, 0]
    for _ in range(2):
        assert job(spec(out), "scene") == f"{out}: the scene is finished. Next are its 3 chapters."
        assert job(spec(out), "chapter", Share(0, 2)) == f"{out}: chapters 1, 3 of 3 are finished."
        assert job(spec(out), "finish") == f"{out / 'reel'}: the reel is complete."
        assert content(out / "reel") == expected
    status = read_status(out)
    assert (status["state"], status["published"], status["done"]) == ("complete", status["groups"], 1.0)
    assert [chapter["state"] for chapter in status["chapters"]] == 3 * ["finished"]
    assert [chapter["attempts"] for chapter in status["chapters"]] == [1, 1, 1]
    log = (out / "work" / "logs" / "chapter0001.log").read_text()
    assert re.match(r"\S+Z attempt 1 on \S+, process \d+, 1 threads, Splatreel", log)
    assert re.search(r"Z group \d/\d is kept\n", log)
    assert re.search(r"Z finished after \d+ s, [\d.]+ GB at most\n$", log)
    assert job(spec(out), "chapter", Share(3, 4)) == f"{out}: task 3 of 4 has none of the 3 chapters."


def test_job_without_its_input_is_refused(scene: Path, tmp_path: Path) -> None:
    with pytest.raises(
        ReconstructionError, match=r"the scene that chapters share is not finished. Run --job scene first"
    ):
        job(spec(tmp_path), "chapter", Share(0, 1))
    with pytest.raises(ReconstructionError, match="scene that chapters share is not finished"):
        job(spec(tmp_path), "finish")
    other = RunSpec(partial(WallCapture, 11), scene, changed(CONFIG, {"seed": 1}), device="cpu")
    with pytest.raises(ReconstructionError, match=r"holds another reconstruction: config.seed is 0 there, 1 now"):
        job(other, "chapter", Share(0, 1))


def test_video_of_one_chapter_is_made_by_its_chapter(tmp_path: Path) -> None:
    short = RunSpec(partial(WallCapture, 2), tmp_path, CONFIG, device="cpu")
    assert "needs no shared scene" in job(short, "scene")
    assert "task 1 of 2 has none" in job(short, "chapter", Share(1, 2))
    with pytest.raises(ReconstructionError, match="its only chapter is not finished"):
        job(short, "finish")
    assert job(short, "chapter", Share(0, 2)) == f"{tmp_path}: chapter 1 of 1 is finished."
    made = content(tmp_path / "reel")
    assert job(short, "finish") == f"{tmp_path / 'reel'}: the reel is complete."
    assert content(tmp_path / "reel") == made


def slurm(task: int, first: int, count: int, **more: str) -> dict[str, str]:
    names = {"SLURM_ARRAY_TASK_ID": task, "SLURM_ARRAY_TASK_MIN": first, "SLURM_ARRAY_TASK_COUNT": count}
    return {name: str(value) for name, value in names.items()} | more


def test_shares_hold_every_chapter_once() -> None:
    chapters = [chapter for index in range(4) for chapter in Share(index, 4).of(10)]
    assert sorted(chapters) == list(range(10))
    assert list(Share(3, 4).of(3)) == []
    assert parse_share(" 2/8") == Share(2, 8)


@pytest.mark.parametrize("text", ["", "8/8", "1", "-1/2", "1/0", "a/b", "1/2/3"])
def test_invalid_shares_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match=r"is not a share of the chapters. Write I/N"):
        parse_share(text)


def test_task_of_a_slurm_array_finds_its_share() -> None:
    assert share_of_task(slurm(0, 0, 8)) == Share(0, 8)
    assert share_of_task(slurm(3, 1, 8)) == Share(2, 8)
    assert share_of_task(slurm(9, 1, 3, SLURM_ARRAY_TASK_STEP="4")) == Share(2, 3)


def test_chapter_job_outside_of_slurm_names_the_option() -> None:
    with pytest.raises(UsageError, match="--chapter I/N, or start a Slurm array task, which sets SLURM_ARRAY"):
        share_of_task({})
    with pytest.raises(UsageError, match="SLURM_ARRAY_TASK_ID 2 is not one of 3 tasks from 1 in steps of 4"):
        share_of_task(slurm(2, 1, 3, SLURM_ARRAY_TASK_STEP="4"))
    with pytest.raises(UsageError, match="is not one of 3 tasks"):
        share_of_task(slurm(7, 1, 3))
