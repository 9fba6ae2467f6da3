"""The process that has others make the chapters: it shows how far all of them are, and publishes what they have made, in order."""

from __future__ import annotations

from splatreel.errors import ReconstructionError
from splatreel.progress import Progress
from splatreel.recon.encode.publisher import Present
from splatreel.recon.jobs import ChapteredRun, ChapterPublisher, has_chapter
from splatreel.recon.machines.reports import ChapterEnded, GroupDone, Noted, Reached, Report

STEPS = 1000
"""Of the bar that shows all chapters."""
SHOWN = 3
"""Failed chapters whose errors a message gives."""


class Driver:
    """Hears what happens to chapters, from when their scene is there to the end. The run is locked while it is used.

    workers: chapters that are made at a time. The attribute `todo` has those that are not finished yet, in their order.
    """

    def __init__(self, run: ChapteredRun, progress: Progress, present: Present, workers: int) -> None:
        self.run, self.progress = run, progress
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

    def hear(self, report: Report) -> None:
        """Show it, and publish the groups whose turn it is."""
        match report:
            case Reached(chapter, share):
                self._shares[chapter] = share
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

    def finish(self) -> None:
        """Declare the reel complete. Raises `ReconstructionError` where chapters have failed, and says why."""
        self._publisher.publish_ready()
        if self.failed:
            raise ReconstructionError(self._failures())
        self.progress.update(STEPS, published=self._publisher.published)
        self._publisher.finish()

    def _end(self, chapter: int, error: str | None) -> None:
        if error is None:
            self._shares[chapter] = 1.0
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
