"""A run as jobs of a batch system, such as Slurm: each does one part of it, on whatever machine that system gives it."""

from __future__ import annotations

from splatreel.codec.reader import ReelReader
from splatreel.errors import ReconstructionError
from splatreel.progress import Progress, parts_of
from splatreel.recon.encode.group_writer import PresentationHook
from splatreel.recon.jobs import ChapteredRun, chapter_job, has_scene, publish_job, scene_job
from splatreel.recon.machines.run_spec import RunSpec
from splatreel.recon.machines.share import JobName, Share
from splatreel.recon.machines.status import RunStatus
from splatreel.recon.pipeline import reconstruct_sequence


def run_job(spec: RunSpec, job: JobName, share: Share | None, progress: Progress, present: PresentationHook) -> str:
    """One job of a run; what is finished is not made again. Returns a sentence about what there is now.

    share: of a job of chapters. A video of one chapter has nothing to share: its chapter makes all of it. Raises
    `ReconstructionError` where what comes before is missing, and as `reconstruct` does.
    """
    with spec.opened() as run:
        many = len(run.chapters)
        if job == "scene":
            if many > 1:
                try:
                    scene_job(run, progress)
                finally:
                    _write_status(run)
            return f"{run.out}: the scene is there. Next are its {many} chapters." if many > 1 else _of_one(run)
        if job == "finish":
            try:
                _finish(run, progress, present)
            finally:
                _write_status(run)
            return f"{run.out / 'reel'}: the reel is complete."
        assert share is not None
        chapters = share.of(many)
        try:
            _make(run, chapters, progress, present)
        finally:
            _write_status(run)
        if not chapters:
            return f"{run.out}: there are {many} chapters, and none for task {share.index} of {share.tasks}."
        return f"{run.out}: {_named(chapters)} of {many} {'is' if len(chapters) == 1 else 'are'} there."


def _make(run: ChapteredRun, chapters: range, progress: Progress, present: PresentationHook) -> None:
    if len(run.chapters) == 1:
        if chapters:
            reconstruct_sequence(run, progress, present)
        return
    if not has_scene(run):
        raise ReconstructionError(f"{run.out}: the scene that chapters share is not there. Run --job scene first.")
    _, *costs = run.costs()
    parts = parts_of(progress, [costs[chapter] for chapter in chapters])
    for chapter, part in zip(chapters, parts, strict=True):
        chapter_job(run, chapter, part)


def _finish(run: ChapteredRun, progress: Progress, present: PresentationHook) -> None:
    if len(run.chapters) > 1:
        publish_job(run, progress, present)
    elif run.store.finished_groups() == len(run.groups):
        reconstruct_sequence(run, progress, present)
    else:
        raise ReconstructionError(f"{run.out}: its only chapter is not finished. Run --job chapter first.")


def _write_status(run: ChapteredRun) -> None:
    """Write OUT/status.json by what checkpoints and logs say: tasks know nothing of each other."""
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


def _of_one(run: ChapteredRun) -> str:
    return f"{run.out}: the video is one chapter of {run.capture.frames} frames, which has no scene to share. Next is the chapter."


def _named(chapters: range) -> str:
    listed = ", ".join(str(chapter + 1) for chapter in chapters[:8]) + (", ..." if len(chapters) > 8 else "")
    return f"chapter{'s'[: len(chapters) > 1]} {listed}"
