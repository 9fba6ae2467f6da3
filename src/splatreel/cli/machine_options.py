"""Options of `splatreel reconstruct` for the machines that make a long video (docs/cluster.md)."""

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
from splatreel.cli.printing import playable
from splatreel.run.machines.batch import JobName, Share, parse_share, share_of_task
from splatreel.storage.address import is_url, local_path

if TYPE_CHECKING:
    from splatreel.base.progress import Progress
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
        from splatreel.cli import estimation

        if self.cluster is not None:
            return estimation.estimated_on_cluster(spec, self.cluster, self._cluster_options())
        return estimation.estimated(spec, self.workers) if self.job is None else estimation.estimated_jobs(spec)

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
