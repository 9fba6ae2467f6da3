"""Driver of a run whose chapters other processes make: it shows the progress of all chapters, and writes their groups in order."""

from __future__ import annotations

import socket

from splatreel.base.errors import ReconstructionError
from splatreel.base.progress import Progress
from splatreel.run.jobs import ChapteredRun, ChapterReelWriter, has_chapter
from splatreel.run.machines.reports import ChapterEnded, GroupDone, Noted, Reached, Report, Started
from splatreel.run.machines.status import RunStatus
from splatreel.run.output.group_writer import PresentationHook

STEPS = 1000
"""Steps of the progress bar of all chapters."""
SHOWN = 3
"""Number of failed chapters whose errors a message gives."""


class Driver:
    """Receives the reports of workers until all chapters have ended. The run must be locked, and its scene finished.

    `workers` chapters are made at a time. The address `url` gets a copy of status.json, if it is given.

    Attributes:
        todo: Chapters that are not finished, in order.
        failed: Errors of failed chapters.
    """

    def __init__(
        self, run: ChapteredRun, progress: Progress, present: PresentationHook, workers: int, url: str | None = None
    ) -> None:
        self.run = run
        self.progress = progress
        self.status = RunStatus(run, url)
        self._attempts = [0] * len(run.chapters)
        self.failed: dict[int, str] = {}
        self._notes: set[str] = set()
        self._reel = ChapterReelWriter(run, present)
        self._reel.write_ready()
        self.todo = [chapter.index for chapter in run.chapters if not has_chapter(run, chapter)]
        scene, *self._costs = run.costs()
        self._whole = scene + sum(self._costs)
        self._shares = [float(chapter.index not in self.todo) for chapter in run.chapters]
        self._begin = self._share(scene)
        self._scene = scene
        if self.todo:
            many, at_once = len(self.todo), min(workers, len(self.todo))
            what = f"{many} chapter{'s'[: many > 1]}{f', {at_once} at a time' if at_once > 1 else ''}"
            progress.stage(f"reconstructing {what}", STEPS, (self._begin, 1.0))

    def __enter__(self) -> Driver:
        self.status.published = self._reel.written
        self.status.write()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if error is not None and self.status.state == "running":
            self.status.state = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
            self.status.write()

    def receive(self, report: Report) -> None:
        """Show a report, and write the groups that are next."""
        match report:
            case Started(chapter, node):
                self._start_chapter(chapter, node)
            case Reached(chapter, share, memory):
                self._shares[chapter] = share
                node = self.status.chapters[chapter].node or socket.gethostname()  # nodes of a cluster send `Started`
                self.status.change(chapter, state="running", done=round(share, 4), memory=memory, node=node)
            case Noted(chapter, text):
                if text not in self._notes:
                    self.progress.note(f"{self._name(chapter)}: {text}")
                self._notes.add(text)
            case GroupDone():
                self._reel.write_ready()
            case ChapterEnded(chapter, error):
                self._end_chapter(chapter, error)
        done = (self._share(self._scene) - self._begin) / max(1 - self._begin, 1e-9)
        self.progress.update(min(round(STEPS * done), STEPS - 1), published=self._reel.written)
        self.status.published = self._reel.written
        self.status.write(at_once=isinstance(report, Started | ChapterEnded))

    def _start_chapter(self, chapter: int, node: str) -> None:
        self._attempts[chapter] += 1
        attempts = self._attempts[chapter]
        if attempts > 1:
            before = self.status.chapters[chapter].node
            self.progress.note(
                f"{self._name(chapter)}: {before} was lost; {node} continues after the last finished group "
                f"(attempt {attempts})"
            )
        self.status.change(chapter, state="running", node=node, attempts=attempts)

    def finish(self) -> None:
        """Declare the reel complete.

        Raises:
            ReconstructionError: Chapters have failed. The error gives their errors.
        """
        self._reel.write_ready()
        self.status.published = self._reel.written
        if self.failed:
            self.status.state = "failed"
            self.status.write()
            raise ReconstructionError(self._failures())
        self.progress.update(STEPS, published=self._reel.written)
        self._reel.finish()
        self.status.state = "complete"
        self.status.write()

    def _end_chapter(self, chapter: int, error: str | None) -> None:
        self.status.change(chapter, state="finished" if error is None else "failed", error=error)
        if error is None:
            self._shares[chapter] = 1.0
            self.status.change(chapter, done=1.0)
            self._reel.write_ready()
        else:
            self.failed[chapter] = error
            self.progress.note(f"{self._name(chapter)} failed: {error}")

    def _share(self, scene: float) -> float:
        """Return the share of the whole run that is done, 0..1. `scene` is the cost of the scene."""
        made = sum(cost * share for cost, share in zip(self._costs, self._shares, strict=True))
        return min((scene + made) / self._whole, 1.0)

    def _name(self, chapter: int) -> str:
        return f"chapter {chapter + 1}/{len(self._costs)}"

    def _failures(self) -> str:
        failed = sorted(self.failed.items())
        errors = " ".join(f"{self._name(chapter)}: {_with_full_stop(error)}" for chapter, error in failed[:SHOWN])
        more = f" And {len(failed) - SHOWN} more." if len(failed) > SHOWN else ""
        return (
            f"{self.run.out}: {len(failed)} of {len(self._costs)} chapters failed. {errors}{more} Finished chapters are kept, and "
            "the reel has the groups before the failed ones. The same command tries them again."
        )


def _with_full_stop(sentence: str) -> str:
    return sentence if sentence.endswith((".", "!", "?")) else f"{sentence}."
