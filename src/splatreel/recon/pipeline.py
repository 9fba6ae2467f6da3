"""The whole way from a capture to a reel: group after group, published as they finish, continued where a run was cut off."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.progress import Progress, Silent, parts_of
from splatreel.recon.encode.group_output import ReelOutput
from splatreel.recon.encode.group_writer import GroupWriter, PresentationHook, no_presentation
from splatreel.recon.encode.soundtrack import select_soundtrack
from splatreel.recon.groups import Handover, reconstruct_groups
from splatreel.recon.jobs import ChapteredRun, ChapterPublisher, chapter_job, scene_job
from splatreel.recon.preparation import open_reel, prepare, save_header
from splatreel.recon.run.device import pick_device
from splatreel.recon.run.memory import check_memory
from splatreel.recon.run.requirements import check_capture
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.static_points import StaticPoints


@dataclass(frozen=True)
class Result:
    """Where a reconstruction lies. seconds: per stage, summed over the groups and over interrupted runs."""

    reel: Path
    work: Path
    seconds: dict[str, float]
    device: str


def reconstruct(
    capture: Capture,
    out: Path,
    config: Config,
    *,
    sound: str = "auto",
    device: str = "auto",
    progress: Progress | None = None,
    present: PresentationHook = no_presentation,
) -> Result:
    """Reconstruct a capture into OUT/reel, with checkpoints in OUT/work; the same call continues an interrupted run.

    sound: auto (the best of the cameras'), none, the name of a camera, or a file. device: auto, cpu or cuda. present: adds what is
    there beside the points. Raises `ReconstructionError` when OUT belongs to another capture or configuration or is in use, or a
    checkpoint is damaged, `UsageError` for a device that is not there, `ReelError` where the disk refuses, and what the capture raises
    for frames or sound that cannot be read. What is finished stays, whatever is raised.
    """
    run = plan_run(capture, out, config, sound=sound, device=device)
    return reconstruct_run(run, progress or Silent(), present)


def plan_run(capture: Capture, out: Path, config: Config, *, sound: str = "auto", device: str = "auto") -> ChapteredRun:
    """What `reconstruct` is going to do; nothing is made yet. Raises as it does, for a capture or a device that will not do."""
    check_capture(capture)
    check_memory(capture, config)
    return ChapteredRun(capture, Path(out), config, sound, pick_device(device))


def reconstruct_run(run: ChapteredRun, progress: Progress, present: PresentationHook) -> Result:
    """All of it, in this process. Raises as `reconstruct` does."""
    if len(run.chapters) > 1:
        reconstruct_chapters(run, progress, present)
    else:
        reconstruct_sequence(run, progress, present)
    return result_of(run)


def result_of(run: ChapteredRun) -> Result:
    return Result(run.out / "reel", run.store.work, run.store.seconds(), run.device.type)


def reconstruct_sequence(run: ChapteredRun, progress: Progress, present: PresentationHook) -> None:
    """A video of one chapter: every group starts from the one before."""
    with run.lock() as lock:
        soundtrack = select_soundtrack(lock.work, run.capture, run.sound, progress)
        job = run.job("", tuple(run.groups), progress)
        rig, layout = prepare(job, run.capture, lock)
        save_header(job, run.capture, rig, layout, soundtrack)
        writer = open_reel(job, lock)
        before = Handover(rig, StaticPoints.none(run.config.keyframe.sh_degree), Gaussians.empty())
        output = ReelOutput(writer, GroupWriter(writer, job.store, job.device), present)
        reconstruct_groups(job, run.capture, layout, before, output)
        present(writer, None)
        writer.finish()


def reconstruct_chapters(run: ChapteredRun, progress: Progress, present: PresentationHook) -> None:
    """A video of several: the scene that they share, and one chapter after the other, each published as it is finished."""
    of_scene, *of_chapters = parts_of(progress, run.costs())
    with run.lock():
        scene_job(run, of_scene)
        publisher = ChapterPublisher(run, present)
        for chapter, part in zip(run.chapters, of_chapters, strict=True):
            publisher.publish_ready()
            chapter_job(run, chapter.index, part)
        publisher.publish_ready()
        publisher.finish()
