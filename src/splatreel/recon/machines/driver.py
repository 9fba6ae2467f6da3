"""The process that has others make the chapters: it shows how far all of them are, and publishes what they have made, in order."""

from __future__ import annotations

import socket

from splatreel.errors import ReconstructionError
from splatreel.progress import Progress
from splatreel.recon.encode.group_writer import PresentationHook
from splatreel.recon.jobs import ChapteredRun, ChapterPublisher, has_chapter
from splatreel.recon.machines.reports import ChapterEnded, GroupDone, Noted, Reached, Report, Started
from splatreel.recon.machines.status import RunStatus

STEPS = 1000
"""Of the bar that shows all chapters."""
SHOWN = 3
"""Failed chapters whose errors a message gives."""


class Driver:
    """Hears what happens to chapters, from when their scene is there to the end. The run is locked while it is used.

    workers: chapters that are made at a time. The attribute `todo` has those that are not finished yet, in their order.
    """

    def __init__(
        self, run: ChapteredRun, progress: Progress, present: PresentationHook, workers: int, url: str | None = None
    ) -> None:
        self.run, self.progress = run, progress
        self.status = RunStatus(run, url)
        self._attempts = [0] * len(run.chapters)
        self.failed: dict[int, str] = {}
        self._told: set[str] = set()
        self._publisher = ChapterPublisher(run, present)
        self._publisher.publish_ready()
        self.todo = [chapter.index for chapter in run.chapters if not has_chapter(run, chapter)]
        scene, *self._costs = run.costs()
        self._whole = scene + sum(self._costs)
        self._shares = [float(chapter.index not in self.todo) for chapter in run.chapters]
        self._begin = self._share(scene)
        self._scene = scene
        if self.todo:
            many, at_once = len(self.todo), min(workers, len(self.todo))
            what = f"{many} chapter{'s'[: many > 1]}{f', {at_once} at a time' if at_once > 1 else ''}"
            progress.stage(f"making {what}", STEPS, (self._begin, 1.0))

    def __enter__(self) -> Driver:
        self.status.published = self._publisher.published
        self.status.write()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if error is not None and self.status.state == "running":
            self.status.state = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
            self.status.write()

    def hear(self, report: Report) -> None:
        """Show it, and publish the groups whose turn it is."""
        match report:
            case Started(chapter, node):
                self._begin_on(chapter, node)
            case Reached(chapter, share, memory):
                self._shares[chapter] = share
                node = self.status.chapters[chapter].node or socket.gethostname()  # of a cluster, `Started` says it
                self.status.change(chapter, state="running", done=round(share, 4), memory=memory, node=node)
            case Noted(chapter, text):
                if text not in self._told:
                    self.progress.note(f"{self._name(chapter)}: {text}")
                self._told.add(text)
            case GroupDone():
                self._publisher.publish_ready()
            case ChapterEnded(chapter, error):
                self._end(chapter, error)
        done = (self._share(self._scene) - self._begin) / max(1 - self._begin, 1e-9)
        self.progress.update(min(round(STEPS * done), STEPS - 1), published=self._publisher.published)
        self.status.published = self._publisher.published
        self.status.write(at_once=isinstance(report, Started | ChapterEnded))

    def _begin_on(self, chapter: int, node: str) -> None:
        self._attempts[chapter] += 1
        attempts = self._attempts[chapter]
        if attempts > 1:
            before = self.status.chapters[chapter].node
            self.progress.note(
                f"{self._name(chapter)}: {before} has lost it; {node} goes on after the last group that was kept "
                f"(attempt {attempts})"
            )
        self.status.change(chapter, state="running", node=node, attempts=attempts)

    def finish(self) -> None:
        """Declare the reel complete. Raises `ReconstructionError` where chapters have failed, and says why."""
        self._publisher.publish_ready()
        self.status.published = self._publisher.published
        if self.failed:
            self.status.state = "failed"
            self.status.write()
            raise ReconstructionError(self._failures())
        self.progress.update(STEPS, published=self._publisher.published)
        self._publisher.finish()
        self.status.state = "complete"
        self.status.write()

    def _end(self, chapter: int, error: str | None) -> None:
        self.status.change(chapter, state="finished" if error is None else "failed", error=error)
        if error is None:
            self._shares[chapter] = 1.0
            self.status.change(chapter, done=1.0)
            self._publisher.publish_ready()
        else:
            self.failed[chapter] = error
            self.progress.note(f"{self._name(chapter)} failed: {error}")

    def _share(self, scene: float) -> float:
        """How much of the whole run is done, 0..1. scene: what it costs."""
        made = sum(cost * share for cost, share in zip(self._costs, self._shares, strict=True))
        return min((scene + made) / self._whole, 1.0)

    def _name(self, chapter: int) -> str:
        return f"chapter {chapter + 1}/{len(self._costs)}"

    def _failures(self) -> str:
        failed = sorted(self.failed.items())
        errors = " ".join(f"{self._name(chapter)}: {_ended(error)}" for chapter, error in failed[:SHOWN])
        more = f" And {len(failed) - SHOWN} more." if len(failed) > SHOWN else ""
        return (
            f"{self.run.out}: {len(failed)} of {len(self._costs)} chapters failed. {errors}{more} What is finished is kept, and the "
            "reel has the groups before them. The same command tries them again."
        )


def _ended(sentence: str) -> str:
    return sentence if sentence.endswith((".", "!", "?")) else f"{sentence}."
