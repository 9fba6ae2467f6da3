"""Reconstruction of a capture into a reel in one process. An interrupted run is continued."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from splatreel.base.progress import Progress, Silent, parts_of
from splatreel.capture.base import Capture
from splatreel.capture.opening import CaptureSource
from splatreel.codec.preview import remove_previews
from splatreel.config import Config
from splatreel.config.settings import with_former_defaults
from splatreel.method.algorithm import FirstGroup
from splatreel.method.init.layout import check_region
from splatreel.run.device_choice import pick_gpu
from splatreel.run.groups import reconstruct_groups
from splatreel.run.jobs import ChapteredRun, ChapterReelWriter, chapter_job, scene_job
from splatreel.run.output.group_output import ReelOutput, RegionOutput
from splatreel.run.output.group_writer import GroupWriter, PresentationHook, no_presentation
from splatreel.run.output.sound_output import select_soundtrack
from splatreel.run.preparation import open_reel_writer, prepare, save_header
from splatreel.run.requirements import check_capture, check_memory, check_networks
from splatreel.run.run_folder import recorded_settings
from splatreel.run.store import Store
from splatreel.scene.gaussians import StaticPoints


@dataclass(frozen=True)
class Result:
    """Folders and times of a finished reconstruction.

    Attributes:
        seconds: Seconds by stage, summed over groups and interrupted runs.
        device: Device that trained, cpu, cuda or gpu.
    """

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
    """Reconstruct a capture into OUT/reel, with checkpoints in OUT/work. The same call continues an interrupted run.

    Finished parts stay, whatever is raised.

    Args:
        capture: The capture, opened at the size to train on.
        out: Output folder OUT.
        config: Settings, such as `preset("standard")`.
        sound: auto (the best soundtrack of the cameras), none, the name of a camera, or a file.
        device: auto, cpu, gpu or cuda.
        progress: Display of the progress; nothing is shown by default.
        present: Adds poster and thumbnails to the reel.

    Raises:
        ReconstructionError: OUT belongs to another capture or configuration, OUT is in use, or a checkpoint is damaged.
        UsageError: The device does not exist.
        MissingDependencyError: A package that the settings need, or its weights, are missing.
        StorageError: The disk is full or cannot be written.
        CaptureError: Frames or sound cannot be read.
    """
    run = plan_run(capture, out, config, sound=sound, device=device)
    return reconstruct_run(run, progress or Silent(), present)


def plan_run(capture: Capture, out: Path, config: Config, *, sound: str = "auto", device: str = "auto") -> ChapteredRun:
    """Return the run that `reconstruct` would make, without starting it. Arguments and errors are those of `reconstruct`."""
    check_capture(capture)
    check_region(config.region, capture.training_cameras)
    check_networks(config.layering)
    check_memory(capture, config)
    config = with_former_defaults(config, recorded_settings(Path(out) / "work"))
    config = config.for_video(0 if capture.growing else capture.frames)
    gpu, note = pick_gpu(device, capture.width, capture.height, config.keyframe.max_points)
    return ChapteredRun(capture, Path(out), config, sound, gpu, note)


def reconstruct_run(run: ChapteredRun, progress: Progress, present: PresentationHook) -> Result:
    """Reconstruct a whole run in this process. Errors are those of `reconstruct`."""
    if run.gpu_note:
        progress.note(run.gpu_note)
    if len(run.chapters) > 1:
        reconstruct_chapters(run, progress, present)
    else:
        reconstruct_sequence(run, progress, present)
    return result_of(run)


def result_of(run: ChapteredRun) -> Result:
    """Return folders and times of a run."""
    return Result(run.out / "reel", run.store.work, run.store.seconds(), run.device_name)


def reconstruct_sequence(run: ChapteredRun, progress: Progress, present: PresentationHook) -> None:
    """Reconstruct a video of one chapter: each group starts from the state of the group before."""
    with run.lock() as lock:
        soundtrack = select_soundtrack(lock.work, run.capture, run.sound, progress)
        job = run.job(progress, run.sequence_plan())
        rig, layout = prepare(job, run.capture, run.groups[0].count // 2, lock)
        save_header(job, run.capture, rig, layout, soundtrack)
        writer = open_reel_writer(job, lock)
        static, seeds = StaticPoints.none(run.config.keyframe.sh_degree), job.store.initial_points()
        before = FirstGroup(rig, static, seeds)
        make_output = RegionOutput if layout.region else ReelOutput
        output = make_output(writer, GroupWriter(writer, job.store), present)
        reconstruct_groups(job, run.groups, run.capture, layout, before, output)
        present(writer, None)
        writer.finish()
        remove_previews(run.out)


def reconstruct_chapters(run: ChapteredRun, progress: Progress, present: PresentationHook) -> None:
    """Reconstruct the shared scene, then one chapter after the other. Each group is written when its chapter is finished."""
    of_scene, *of_chapters = parts_of(progress, run.costs())
    with run.lock():
        scene_job(run, of_scene)
        reel = ChapterReelWriter(run, present)
        for chapter, part in zip(run.chapters, of_chapters, strict=True):
            reel.write_ready()
            chapter_job(run, chapter.index, part)
        reel.write_ready()
        reel.finish()


@dataclass(frozen=True)
class RunSpec:
    """Arguments of `pipeline.reconstruct`, in a form that can be pickled.

    Attributes:
        open_capture: Called by each process to open the capture, such as `CaptureSource(path, {"width": 640})`. A `CaptureSource` gets
            the frame tables of the run, so that no video is scanned twice.
        device: auto, cpu, gpu or cuda.
    """

    open_capture: Callable[[], Capture] | CaptureSource
    out: Path
    config: Config
    sound: str = "auto"
    device: str = "auto"

    @contextmanager
    def opened(self) -> Iterator[ChapteredRun]:
        """Give the run, with its capture open.

        Raises:
            SplatreelError: As opening the capture or `plan_run` raises it.
        """
        known = Store(self.out / "work").tables_file
        source = self.open_capture
        capture = source(known) if isinstance(source, CaptureSource) else source()
        try:
            yield plan_run(capture, self.out, self.config, sound=self.sound, device=self.device)
        finally:
            capture.close()
