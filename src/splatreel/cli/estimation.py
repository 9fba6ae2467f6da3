"""Text of `splatreel reconstruct --estimate`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from splatreel.base.progress import format_rounded, format_seconds
from splatreel.cli.printing import counted

if TYPE_CHECKING:
    from splatreel.run.estimate import Estimate
    from splatreel.run.jobs import ChapteredRun
    from splatreel.run.machines.ray_cluster import ClusterOptions
    from splatreel.run.pipeline import RunSpec


def estimated(spec: RunSpec, workers: int | None) -> str:
    """Return time and memory of a run on this machine, in lines. Nothing is written.

    Raises:
        SplatreelError: As the run itself would raise it before it starts.
    """
    from splatreel.run.estimate import estimate
    from splatreel.run.machine_speed import describe_processor, measure_run_speed
    from splatreel.run.machines.local_processes import division_of

    with spec.opened() as run:
        found = estimate(run, division_of(run, workers), measure_run_speed(run.gpu))
        processor = f"Processor: {describe_processor()}."
        return "\n".join([_time(run, found), *_stages(found), processor, *_memory(run, found), *_notes(run)])


def estimated_jobs(spec: RunSpec) -> str:
    """Return time, memory and number of the tasks of a batch system, in lines. Nothing is written.

    Raises:
        SplatreelError: As the run itself would raise it before it starts.
    """
    from splatreel.base import threads
    from splatreel.run.estimate import estimate_jobs
    from splatreel.run.machine_speed import measure_run_speed

    with spec.opened() as run:
        count = threads.count()
        found = estimate_jobs(run, count, count, None, measure_run_speed(run.gpu))
        gibibytes = math.ceil(1.2 * found.memory / 2**30)
        return "\n".join(
            [
                _heading(run, found.chapters),
                f"  --job scene    about {format_rounded(found.scene)}"
                if found.scene
                else "  --job scene    nothing to do",
                f"  --job chapter  about {format_rounded(found.chapter)} a chapter",
                "  --job finish   about a minute",
                f"Each task: {counted(count, 'thread')} as fast as here; about {found.memory / 1e9:.1f} GB of memory, such as "
                f"--mem={gibibytes}G.",
                f"Array: up to {counted(found.chapters, 'task')} (--array=0-{found.chapters - 1}); with all at once the reel takes "
                f"about {format_rounded(found.total)}.",
                *_notes(run),
            ]
        )


def estimated_on_cluster(spec: RunSpec, address: str, options: ClusterOptions) -> str:
    """Return time and memory on a Ray cluster in its present state, in lines. Nothing is written.

    Raises:
        SplatreelError: As the run itself would raise it before it starts.
    """
    from splatreel.run.estimate import estimate_jobs
    from splatreel.run.machine_speed import measure_run_speed
    from splatreel.run.machines.ray_cluster import connected, share_nodes
    from splatreel.run.requirements import needed_memory

    with connected(address) as ray, spec.opened() as run:
        need = needed_memory(run.capture, run.config)
        plan = share_nodes(ray.nodes(), len(run.chapters), spec.device, need, options.threads)
        scene, chapter = plan.scene.cores, plan.chapter.cores
        found = estimate_jobs(run, scene, chapter, plan.at_once, measure_run_speed(run.gpu))
        shown = f"  the scene      about {format_rounded(found.scene)} on a node, with {counted(scene, 'thread')}"
        return "\n".join(
            [
                _heading(run, found.chapters),
                *([shown] if found.scene else []),
                f"  a chapter      about {format_rounded(found.chapter)}, with {counted(chapter, 'thread')}",
                f"  all            about {format_rounded(found.total)}, with {found.at_once} of {found.chapters} chapters at a time",
                f"Memory: about {found.memory / 1e9:.1f} GB for each of them.",
                *_notes(run),
            ]
        )


def _heading(run: ChapteredRun, chapters: int) -> str:
    capture = run.capture
    return (
        f"{capture.path}: {counted(capture.frames, 'frame')} of {counted(len(capture.training_cameras), 'camera')}, "
        f"{capture.width}x{capture.height}, {counted(chapters, 'chapter')}. If nothing else runs:"
    )


def _time(run: ChapteredRun, found: Estimate) -> str:
    capture, division = run.capture, found.division
    threads = counted(division.threads, "thread")
    work = threads if division.workers == 1 else f"{division.workers} chapters at a time, {threads} each"
    return (
        f"{capture.path}: {counted(capture.frames, 'frame')} of {counted(len(capture.training_cameras), 'camera')}, "
        f"{capture.width}x{capture.height}, take about {format_rounded(found.total)} from the beginning ({work}), if nothing else runs:"
    )


def _stages(found: Estimate) -> list[str]:
    """Return a line for each kind of stage that takes time, in their order."""
    from splatreel.run.job import READING
    from splatreel.run.steps import STEPS

    labels = {READING: "reading images"} | {step.timing: step.label for step in STEPS.values()}
    times = dict.fromkeys(labels.values(), 0.0)
    for name, label in labels.items():
        times[label] += found.seconds.get(name, 0.0)
    return [f"  {label:<37}{format_seconds(seconds):>12}" for label, seconds in times.items() if seconds >= 0.05]


def _memory(run: ChapteredRun, found: Estimate) -> list[str]:
    from splatreel.run.requirements import FITS, fitting_width, free_memory

    free, text = free_memory(), f"Memory: about {found.memory / 1e9:.1f} GB at most"
    if free is None:
        return [f"{text}."]
    if found.memory <= free:
        return [f"{text}; {free / 1e9:.1f} GB are free."]
    width = fitting_width(run.capture, run.config, FITS * free)
    smaller = "" if width is None else f", or choose --width {width}, which fits"
    return [f"{text}, but only {free / 1e9:.1f} GB are free: close other programs{smaller}."]


def _notes(run: ChapteredRun) -> list[str]:
    notes = []
    if run.capture.backgrounds:
        from splatreel.method.prediction.quality import expected_gain
        from splatreel.scene.camera import angles_apart, focus_point

        cameras = run.capture.training_cameras
        angles = angles_apart(cameras, focus_point(cameras)).min(1)
        gain = expected_gain([camera.name for camera in cameras], angles)
        notes.append(f"Subject of the masks: {gain} `splatreel capture check --masks` predicts its quality by a trial.")
    if run.device_name == "cpu":
        return notes
    name = "" if run.gpu is None else f", {run.gpu.adapter.name}"
    return [*notes, f"Training on a GPU{name}: the time is a guess from a few training steps."]
