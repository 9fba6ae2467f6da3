"""Chapters made by several processes of this machine: the same reel, whatever happens to them."""

import multiprocessing
import os
import signal
from pathlib import Path

import pytest

from splatreel import threads
from splatreel.errors import ReconstructionError
from splatreel.progress import Silent
from splatreel.recon.machines.here import reconstruct_here
from tests.recon.machines.runs import spec
from tests.recon.test_pipeline import content


class Display(Silent):
    """What a user is shown. after: called with each number of groups that are in the reel."""

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


@pytest.mark.usefixtures("two_cores")
def test_two_workers_make_the_reel_that_one_makes(out: Path, expected: dict[str, str]) -> None:
    display = Display()
    result = reconstruct_here(spec(out), workers=2, progress=display)
    assert content(result.reel) == expected
    ((name, span),) = display.stages
    assert name == "making 3 chapters, 2 at a time"
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


@pytest.mark.usefixtures("two_cores")
def test_a_worker_that_is_killed_is_replaced_once(out: Path, expected: dict[str, str]) -> None:
    killed = []

    def kill(published: int) -> None:
        if published and not killed:
            killed.extend(multiprocessing.active_children())
            os.kill(killed[0].pid, signal.SIGKILL)

    display = Display(kill)
    result = reconstruct_here(spec(out), workers=2, progress=display)
    assert content(result.reel) == expected
    (note,) = [note for note in display.notes if "SIGKILL" in note]
    assert note.endswith("it is tried again, with 1 at a time in case it was for want of memory")


@pytest.mark.usefixtures("two_cores")
def test_a_chapter_that_fails_leaves_the_others_and_is_tried_again_by_the_same_command(
    out: Path, expected: dict[str, str], tmp_path: Path
) -> None:
    spoilt = tmp_path / "spoilt"
    spoilt.touch()
    with pytest.raises(
        ReconstructionError, match=r"1 of 3 chapters failed. chapter 2/3: frame 4 is spoilt. Mend it. What"
    ):
        reconstruct_here(spec(out, spoilt), workers=2)
    assert (out / "work" / "group0004" / "encoded-group.safetensors").exists()
    spoilt.unlink()
    display = Display()
    result = reconstruct_here(spec(out, spoilt), workers=2, progress=display)
    assert display.stages[0][0] == "making 1 chapter"
    assert content(result.reel) == expected
