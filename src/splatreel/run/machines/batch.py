"""Jobs of a batch system, such as Slurm: each makes one part of a run, on the machine that the batch system gives it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from splatreel.base.errors import ReconstructionError, UsageError
from splatreel.base.progress import Progress, parts_of
from splatreel.codec.reader import ReelReader
from splatreel.run.jobs import ChapteredRun, chapter_job, has_scene, reel_job, scene_job
from splatreel.run.machines.status import RunStatus
from splatreel.run.output.group_writer import PresentationHook
from splatreel.run.pipeline import RunSpec, reconstruct_sequence

JobName = Literal["scene", "chapter", "finish"]


@dataclass(frozen=True)
class Share:
    """One of several equal shares of the chapters: those whose number divided by `tasks` leaves the remainder `index`."""

    index: int
    tasks: int

    def of(self, chapters: int) -> range:
        """Return the chapters of the share."""
        return range(self.index, chapters, self.tasks)


def parse_share(text: str) -> Share:
    """Return the share that a text such as `2/8` names, the third of eight.

    Raises:
        UsageError: The text names no share.
    """
    match = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text.strip())
    if match is None or int(match[1]) >= int(match[2]):
        raise UsageError(
            f"--chapter {text!r:.60} is not a share of the chapters. Write I/N for task I of N, counted from 0, such as 0/8."
        )
    return Share(int(match[1]), int(match[2]))


def share_of_task(variables: Mapping[str, str]) -> Share:
    """Return the share of a task of a Slurm job array, from its environment variables.

    Raises:
        UsageError: The process is not such a task.
    """
    names = ("SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_COUNT")
    missing = [name for name in names if not variables.get(name, "").isdecimal()]
    if missing:
        raise UsageError(
            f"--job chapter: its chapters are unknown. Give --chapter I/N, or start a Slurm array task, which sets {missing[0]}."
        )
    task, first, tasks = (int(variables[name]) for name in names)
    step = max(int(variables.get("SLURM_ARRAY_TASK_STEP") or 1), 1)
    index, rest = divmod(task - first, step)
    if rest or not 0 <= index < tasks:
        raise UsageError(
            f"--job chapter: SLURM_ARRAY_TASK_ID {task} is not one of {tasks} tasks from {first} in steps of {step}. "
            "Give --chapter I/N."
        )
    return Share(index, tasks)


def run_job(spec: RunSpec, job: JobName, share: Share | None, progress: Progress, present: PresentationHook) -> str:
    """Run one job of a run. Finished parts are not made again.

    Args:
        spec: The run.
        job: scene, chapter or finish. A video of one chapter has no scene: its chapter job makes everything.
        share: The chapters of a chapter job; None for the other jobs.
        progress: Display of the progress.
        present: Adds poster and thumbnails to the reel.

    Returns:
        A sentence about what exists now.

    Raises:
        ReconstructionError: An earlier job is not finished, or as `pipeline.reconstruct` raises it.
    """
    with spec.opened() as run:
        many = len(run.chapters)
        if job == "scene":
            if many > 1:
                try:
                    scene_job(run, progress)
                finally:
                    _write_status(run)
            return f"{run.out}: the scene is finished. Next are its {many} chapters." if many > 1 else _one_chapter(run)
        if job == "finish":
            try:
                _finish(run, progress, present)
            finally:
                _write_status(run)
            return f"{run.out / 'reel'}: the reel is complete."
        assert share is not None
        chapters = share.of(many)
        try:
            _make_chapters(run, chapters, progress, present)
        finally:
            _write_status(run)
        if not chapters:
            return f"{run.out}: task {share.index} of {share.tasks} has none of the {many} chapters."
        return f"{run.out}: {_named(chapters)} of {many} {'is' if len(chapters) == 1 else 'are'} finished."


def _make_chapters(run: ChapteredRun, chapters: range, progress: Progress, present: PresentationHook) -> None:
    if len(run.chapters) == 1:
        if chapters:
            reconstruct_sequence(run, progress, present)
        return
    if not has_scene(run):
        raise ReconstructionError(f"{run.out}: the scene that chapters share is not finished. Run --job scene first.")
    _, *costs = run.costs()
    parts = parts_of(progress, [costs[chapter] for chapter in chapters])
    for chapter, part in zip(chapters, parts, strict=True):
        chapter_job(run, chapter, part)


def _finish(run: ChapteredRun, progress: Progress, present: PresentationHook) -> None:
    if len(run.chapters) > 1:
        reel_job(run, progress, present)
    elif run.store.finished_groups() == len(run.groups):
        reconstruct_sequence(run, progress, present)
    else:
        raise ReconstructionError(f"{run.out}: its only chapter is not finished. Run --job chapter first.")


def _write_status(run: ChapteredRun) -> None:
    """Write OUT/status.json from checkpoints and logs, since tasks do not know of each other."""
    if len(run.chapters) == 1 or not run.out.exists():
        return
    status = RunStatus(run)
    manifest = run.out / "reel" / "manifest.json"
    if manifest.exists():
        written = ReelReader(manifest.parent).manifest
        status.published = written.end_group
        status.state = "running" if written.live else "complete"
    if status.state != "complete" and any(chapter.state == "failed" for chapter in status.chapters):
        status.state = "failed"
    status.write()


def _one_chapter(run: ChapteredRun) -> str:
    return f"{run.out}: the video is one chapter of {run.capture.frames} frames, which needs no shared scene. Next is the chapter."


def _named(chapters: range) -> str:
    listed = ", ".join(str(chapter + 1) for chapter in chapters[:8]) + (", ..." if len(chapters) > 8 else "")
    return f"chapter{'s'[: len(chapters) > 1]} {listed}"
