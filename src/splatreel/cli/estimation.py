"""What `splatreel reconstruct --estimate` says instead of making a reel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from splatreel.cli.output import counted
from splatreel.progress import format_seconds

if TYPE_CHECKING:
    from splatreel.recon.jobs import ChapteredRun
    from splatreel.recon.machines.estimate import Estimate
    from splatreel.recon.machines.run_spec import RunSpec

STAGES = {
    "reading": "reading pictures",
    "points": "first points, checking cameras",
    "cameras": "exposures and poses",
    "keyframe": "keyframes",
    "layering": "what moves from what rests",
    "tracking": "following what moves",
    "group": "learning how it moves",
    "encode": "writing",
}


def estimated(spec: RunSpec, workers: int | None) -> str:
    """Time and memory of a run, in lines. Writes nothing; raises what the run itself would raise before it starts."""
    from splatreel.recon.machines.estimate import estimate
    from splatreel.recon.machines.here import division_of
    from splatreel.recon.run.machine_speed import measure_speed
    from splatreel.recon.run.processor import describe_processor

    with spec.opened() as run:
        found = estimate(run, division_of(run, workers), measure_speed(run.device))
        processor = f"Processor: {describe_processor()}."
        return "\n".join([_time(run, found), *_stages(found), processor, *_memory(run, found), *_notes(run)])


def _time(run: ChapteredRun, found: Estimate) -> str:
    capture, division = run.capture, found.division
    threads = counted(division.threads, "thread")
    work = threads if division.workers == 1 else f"{division.workers} chapters at a time, {threads} each"
    return (
        f"{capture.path}: {counted(capture.frames, 'frame')} of {counted(len(capture.training_cameras), 'camera')}, "
        f"{capture.width}x{capture.height}, take about {_rounded(found.total)} from the beginning ({work}), if nothing else runs:"
    )


def _rounded(seconds: float) -> str:
    """Seconds of what takes minutes are not known."""
    return format_seconds(seconds if seconds < 60 else 60 * round(seconds / 60)).replace(" 00 s", "")


def _stages(found: Estimate) -> list[str]:
    """Those that take time, in their order."""
    told = [(words, found.seconds.get(stage, 0.0)) for stage, words in STAGES.items()]
    return [f"  {words:<31}{format_seconds(seconds):>12}" for words, seconds in told if seconds >= 0.05]


def _memory(run: ChapteredRun, found: Estimate) -> list[str]:
    from splatreel.recon.run.memory import FITS, fitting_width, free_memory

    free, said = free_memory(), f"Memory: about {found.memory / 1e9:.1f} GB at most"
    if free is None:
        return [f"{said}."]
    if found.memory <= free:
        return [f"{said}; {free / 1e9:.1f} GB are free."]
    width = fitting_width(run.capture, run.config, FITS * free)
    smaller = "" if width is None else f", or choose --width {width}, which fits"
    return [f"{said}, but only {free / 1e9:.1f} GB are free: end other programs{smaller}."]


def _notes(run: ChapteredRun) -> list[str]:
    if run.device.type != "cuda":
        return []
    return ["Training on a GPU was never timed: the time is a guess, from one step of it."]
