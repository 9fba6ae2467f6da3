"""Options of `splatreel reconstruct` for the machines that make a long video, and the text of --estimate."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from splatreel.base import threads
from splatreel.base.errors import UsageError
from splatreel.base.progress import format_rounded, format_seconds
from splatreel.cli.printing import counted, playable
from splatreel.run.machines.share import JobName, Share, parse_share, share_of_task
from splatreel.storage.address import is_url, local_path

if TYPE_CHECKING:
    from splatreel.base.progress import Progress
    from splatreel.capture.base import Capture
    from splatreel.run.estimate import Estimate
    from splatreel.run.jobs import ChapteredRun
    from splatreel.run.machines.ray_cluster import ClusterOptions
    from splatreel.run.output.group_writer import PresentationHook
    from splatreel.run.pipeline import RunSpec


@dataclass(frozen=True)
class MachineOptions:
    """Machines that make a long video (docs/cluster.md)."""

    workers: int | None = None
    """For a long video: number of chapters to make at a time on this machine; by default a number that suits it."""
    job: JobName | None = None
    """For a long video: run one job of a batch system only: the scene that chapters share, chapters, or the finished reel
    (docs/cluster.md)."""
    chapter: str | None = None
    """With --job chapter: the chapters of task I of N tasks, as I/N, counted from 0; by default those of a Slurm array task."""
    cluster: str | None = None
    """Make the chapters of a long video on a Ray cluster: auto, or HOST:PORT (needs splatreel[cluster]; docs/cluster.md)."""
    cluster_retries: int = 3
    """With --cluster: how often a chapter is given to another node when its own is lost."""
    cluster_wait: float = 0.0
    """With --cluster: seconds to wait for a node that can hold a chapter, such as from an autoscaler."""

    def check(self, out: str, follow: bool, estimate: bool = False) -> None:
        """Check that the options fit together.

        Args:
            out: Output folder or address.
            follow: True for a capture that is still being written.
            estimate: True if only an estimate is wanted.

        Raises:
            UsageError: They do not.
        """
        ways = {"--workers": self.workers, "--job": self.job, "--cluster": self.cluster, "--follow": follow or None}
        given = [name for name, value in ways.items() if value is not None]
        if len(given) > 1:
            raise UsageError(f"{' and '.join(given)} exclude each other. Give one of them.")
        if estimate and follow:
            raise UsageError("--estimate is for complete captures. Leave out --follow.")
        if self.cluster_retries < 0:
            raise UsageError(f"--cluster-retries {self.cluster_retries}: give 0 or more.")
        if not 0 <= self.cluster_wait < math.inf:
            raise UsageError(f"--cluster-wait {self.cluster_wait:g}: give seconds, 0 or more.")
        if self.chapter is not None and self.job != "chapter":
            raise UsageError("--chapter names the chapters of a job of a batch system. Add --job chapter.")
        if self.cluster is None and _is_remote(out):
            raise UsageError(
                f"--out {out}: is not a folder of this machine; only --cluster writes elsewhere. Choose a folder, and copy the reel "
                "while it grows with --publish."
            )
        if not estimate:
            self.share()

    def share(self) -> Share | None:
        """Return the chapters of a chapter job; None for any other run.

        Raises:
            UsageError: The chapters are not given.
        """
        if self.job != "chapter":
            return None
        return share_of_task(os.environ) if self.chapter is None else parse_share(self.chapter)

    @contextmanager
    def folder(self, out: str) -> Iterator[Path]:
        """Give the folder on this machine to work in: OUT, or a temporary one if OUT is elsewhere."""
        from splatreel.base.atomic import scratch

        if _is_remote(out):
            with scratch(Path(tempfile.gettempdir()), "splatreel-driver") as place:
                yield place
        else:
            path = local_path(out)
            assert path is not None
            yield path

    def published(self, out: str, publish: str | None) -> str | None:
        """Return the address that the reel is copied to while it grows, if any.

        Raises:
            UsageError: There would be two addresses.
        """
        if not _is_remote(out):
            return publish
        if publish is not None:
            raise UsageError(f"--publish {publish}: the reel is already written to {out}. Leave out one of them.")
        return f"{out.rstrip('/')}/reel"

    def reconstruct(self, spec: RunSpec, out: str, progress: Progress, present: PresentationHook) -> str:
        """Reconstruct a run on the chosen machines, and return the closing message.

        Args:
            spec: The run.
            out: Output folder or address, as the user gave it.
            progress: Display of the progress.
            present: Adds poster and thumbnails to the reel.
        """
        if self.cluster is not None:
            return self._reconstruct_on_cluster(spec, self.cluster, out, progress, present)
        if self.job is not None:
            from splatreel.run.machines.batch import run_job

            return run_job(spec, self.job, self.share(), progress, present)
        from splatreel.run.machines.local_processes import reconstruct_here

        return playable(reconstruct_here(spec, workers=self.workers, progress=progress, present=present).reel)

    def estimated(self, spec: RunSpec) -> str:
        """Return the time and memory of a run on the chosen machines, in lines."""
        if self.cluster is not None:
            return estimated_on_cluster(spec, self.cluster, self._cluster_options())
        return estimated(spec, self.workers) if self.job is None else estimated_jobs(spec)

    def _reconstruct_on_cluster(
        self, spec: RunSpec, address: str, out: str, progress: Progress, present: PresentationHook
    ) -> str:
        from splatreel.run.machines.ray_cluster import reconstruct_on_cluster

        url = out if _is_remote(out) else None
        result = reconstruct_on_cluster(
            spec, address, url=url, options=self._cluster_options(), progress=progress, present=present
        )
        return playable(result.reel) if url is None else f"{out.rstrip('/')}/reel: the reel is complete."

    def _cluster_options(self) -> ClusterOptions:
        from splatreel.run.machines.ray_cluster import ClusterOptions

        return ClusterOptions(self.cluster_retries, self.cluster_wait, threads.chosen())


def _is_remote(out: str) -> bool:
    return is_url(out) and local_path(out) is None


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


def _described(capture: Capture) -> str:
    frames, cameras = counted(capture.frames, "frame"), counted(len(capture.training_cameras), "camera")
    return f"{capture.path}: {frames} of {cameras}, {capture.width}x{capture.height}"


def _heading(run: ChapteredRun, chapters: int) -> str:
    return f"{_described(run.capture)}, {counted(chapters, 'chapter')}. If nothing else runs:"


def _time(run: ChapteredRun, found: Estimate) -> str:
    division, spent = found.division, format_rounded(found.total)
    threads = counted(division.threads, "thread")
    work = threads if division.workers == 1 else f"{division.workers} chapters at a time, {threads} each"
    return f"{_described(run.capture)}, take about {spent} from the beginning ({work}), if nothing else runs:"


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
