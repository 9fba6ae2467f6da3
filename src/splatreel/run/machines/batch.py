"""Jobs of a batch system, such as Slurm: each makes one part of a run, on the machine that the batch system gives it."""

from __future__ import annotations

from splatreel.base.errors import ReconstructionError
from splatreel.base.progress import Progress, parts_of
from splatreel.codec.reader import ReelReader
from splatreel.run.jobs import ChapteredRun, chapter_job, has_scene, reel_job, scene_job
from splatreel.run.machines.share import JobName, Share
from splatreel.run.machines.status import RunStatus
from splatreel.run.output.group_writer import PresentationHook
from splatreel.run.pipeline import RunSpec, reconstruct_sequence


def run_job(spec: RunSpec, job: JobName, share: Share | None, progress: Progress, present: PresentationHook) -> str:
    """Run one job of a run, and return a sentence about what exists now. Finished parts are not made again.

    A video of one chapter has no scene: its chapter job makes everything. `share` is for chapter jobs.

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
