"""Chapters made by several processes of this machine give the same reel, even if processes are killed."""

import json
import multiprocessing
import os
import re
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from splatreel.base import threads
from splatreel.base.errors import ReconstructionError, UsageError
from splatreel.base.progress import Silent
from splatreel.run.estimate import Division
from splatreel.run.machines import local_processes
from splatreel.run.machines.local_processes import Worker, WorkerPool, division_of, places, reconstruct_here
from tests.method.captures import WallCapture
from tests.method.small import small
from tests.run.machines.runs import spec
from tests.run.test_pipeline import content


class Display(Silent):
    """Display of a user. after: called with each number of groups in the reel."""

    def __init__(self, after=lambda published: None) -> None:
        self.stages, self.steps, self.notes, self.published = [], [], [], []
        self.after = after

    def stage(self, name, total, span=None) -> None:
        self.stages.append((name, span))

    def update(self, done, **numbers) -> None:
        self.steps.append(done)
        if "published" in numbers:
            self.published.append(numbers["published"])
            self.after(numbers["published"])

    def note(self, text) -> None:
        self.notes.append(text)


@pytest.fixture
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "count", lambda: 2)


@pytest.mark.slow
@pytest.mark.usefixtures("two_cores")
def test_two_workers_make_the_reel_that_one_makes(out: Path, expected: dict[str, str]) -> None:
    display = Display()
    result = reconstruct_here(spec(out), workers=2, progress=display)
    assert content(result.reel) == expected
    ((name, span),) = display.stages
    assert name == "reconstructing 3 chapters, 2 at a time"
    assert span[0] < span[1] == 1.0
    assert display.steps[-1] == 1000
    assert display.published == sorted(display.published)
    assert display.published[-1] == 5
    assert len(set(display.published)) > 2  # it grows while it is made
    assert all(note.startswith("chapter ") for note in display.notes)
    assert len({note.partition(": ")[2] for note in display.notes}) == len(display.notes)
    assert multiprocessing.active_children() == []
    again = Display()
    assert content(reconstruct_here(spec(out), workers=2, progress=again).reel) == expected
    assert again.stages == []


@pytest.mark.slow
@pytest.mark.kill
@pytest.mark.usefixtures("two_cores")
def test_worker_that_is_killed_is_replaced_once(out: Path, expected: dict[str, str]) -> None:
    killed = []

    def kill(published: int) -> None:
        if published and not killed:
            killed.extend(multiprocessing.active_children())
            os.kill(killed[0].pid, signal.SIGKILL)

    display = Display(kill)
    result = reconstruct_here(spec(out), workers=2, progress=display)
    assert content(result.reel) == expected
    (note,) = [note for note in display.notes if "SIGKILL" in note]
    assert note.endswith("it is tried again, with 1 at a time in case memory ran out")


@pytest.mark.slow
@pytest.mark.usefixtures("two_cores")
def test_failed_chapter_is_retried_by_the_same_command(out: Path, expected: dict[str, str], tmp_path: Path) -> None:
    spoilt = tmp_path / "spoilt"
    spoilt.touch()
    with pytest.raises(
        ReconstructionError, match=r"1 of 3 chapters failed. chapter 2/3: frame 4 is spoilt. Mend it. Finished chapters"
    ):
        reconstruct_here(spec(out, spoilt), workers=2)
    assert (out / "work" / "group0004" / "encoded-group.safetensors").exists()
    status = json.loads((out / "status.json").read_text())
    assert (status["state"], [chapter["state"] for chapter in status["chapters"]]) == (
        "failed",
        ["finished", "failed", "finished"],
    )
    assert status["chapters"][1]["error"] == "frame 4 is spoilt. Mend it."
    log = out / "work" / "logs" / "chapter0001.log"
    assert "failed after" in log.read_text()
    assert "Traceback (most recent call last)" in log.read_text()
    spoilt.unlink()
    display = Display()
    result = reconstruct_here(spec(out, spoilt), workers=2, progress=display)
    assert display.stages[0][0] == "reconstructing 1 chapter"
    assert re.search(r"\n\S+Z attempt 2 on ", log.read_text())
    status = json.loads((out / "status.json").read_text())
    assert (status["state"], status["chapters"][1]["state"], status["chapters"][1]["error"]) == (
        "complete",
        "finished",
        None,
    )
    assert content(result.reel) == expected


def a_run(device: str, chapters: int = 6) -> Any:
    """Return a stand-in of a run."""
    config, capture = small({"group.length": 30}), WallCapture(60)
    return SimpleNamespace(device_name=device, gpu=None, chapters=list(range(chapters)), config=config, capture=capture)


def test_each_gpu_of_a_machine_is_a_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "count", lambda: 16)
    monkeypatch.setattr(local_processes, "count_cuda_devices", lambda: 4)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert division_of(a_run("cuda")) == Division(4, 4)
    assert places(a_run("cuda"), 4) == ["0", "1", "2", "3"]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,6")
    assert places(a_run("cuda"), 3) == ["4", "6", "4"]
    assert places(a_run("cpu"), 3) == [None, None, None]


def test_number_of_workers_follows_option_and_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "count", lambda: 16)
    assert division_of(a_run("cpu"), 5) == Division(5, 3)
    assert division_of(a_run("cpu", chapters=2), 5) == Division(2, 8)
    monkeypatch.setattr(local_processes, "free_memory", lambda: 3 << 29)
    assert division_of(a_run("cpu")) == Division(2, 8)
    monkeypatch.setattr(local_processes, "free_memory", lambda: 0)
    assert division_of(a_run("cpu")) == Division(1, 16)
    for workers in (0, 17):
        with pytest.raises(
            UsageError, match=rf"--workers {workers} is out of range: this process has 16 cores. Choose 1"
        ):
            division_of(a_run("cpu"), workers)


class Line:
    """A connection to a worker that does not exist."""

    def send(self, chapter: int) -> None: ...


def test_chapter_waits_for_free_memory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pool = WorkerPool(spec(tmp_path), [None] * 4, 1, need=100)
    monkeypatch.setattr(pool, "_start", lambda: pool._workers.append(Worker(None, Line(), None)) or pool._workers[-1])  # pyright: ignore[reportArgumentType]
    pool._waiting.extend(range(4))
    monkeypatch.setattr(local_processes, "free_memory", lambda: 0)
    pool._hand_out()
    assert [worker.chapter for worker in pool._workers] == [0]  # one is made whatever there is
    monkeypatch.setattr(local_processes, "free_memory", lambda: 299)
    pool._hand_out()
    assert len(pool._busy) == 2  # the first will take 100, and the second as well
    pool._workers[0].memory = 150
    pool._hand_out()
    assert len(pool._busy) == 2  # by now it is known that a chapter takes 150
    monkeypatch.setattr(local_processes, "free_memory", lambda: 300)
    pool._hand_out()
    assert len(pool._busy) == 3
    monkeypatch.setattr(local_processes, "free_memory", lambda: None)
    pool._hand_out()
    assert [worker.chapter for worker in pool._workers] == [0, 1, 2, 3]
