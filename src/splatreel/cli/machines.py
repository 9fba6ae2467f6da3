"""Where `splatreel reconstruct` has a long video made: on this machine, by a batch system, on a cluster (docs/cluster.md)."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatreel import threads
from splatreel.cli.output import playable
from splatreel.config import Config
from splatreel.errors import UsageError
from splatreel.recon.machines.share import JobName, Share, parse_share, share_of_task
from splatreel.storage.addresses import is_url, local_path

if TYPE_CHECKING:
    from splatreel.capture.opening import CaptureSource
    from splatreel.recon.machines.ray_cluster import ClusterOptions
    from splatreel.recon.machines.run_spec import RunSpec


@dataclass(frozen=True)
class Machines:
    workers: int | None = None
    """Of a long video, how many chapters to make at a time on this machine; as many as suit it by default."""
    job: JobName | None = None
    """Of a long video, do one job of a batch system only: the scene that chapters share, chapters, or the finished reel
    (docs/cluster.md)."""
    chapter: str | None = None
    """With --job chapter: which ones, as I/N: those of task I of N, counted from 0; by default those of a task of Slurm's array."""
    cluster: str | None = None
    """Have the chapters of a long video made by a Ray cluster: auto, or HOST:PORT (needs splatreel[cluster]; docs/cluster.md)."""
    cluster_retries: int = 3
    """With --cluster: how often a chapter is given to another node when its own is lost."""
    cluster_wait: float = 0.0
    """With --cluster: seconds to wait for a node that can hold a chapter, such as from an autoscaler."""

    def check(self, out: str, follow: bool, estimate: bool = False) -> None:
        """Raises `UsageError` for options that do not go together."""
        ways = {"--workers": self.workers, "--job": self.job, "--cluster": self.cluster, "--follow": follow or None}
        given = [name for name, value in ways.items() if value is not None]
        if len(given) > 1:
            raise UsageError(f"{' and '.join(given)} exclude each other. Give one of them.")
        if estimate and follow:
            raise UsageError("--estimate is of captures that are complete. Leave out --follow.")
        if self.cluster_retries < 0:
            raise UsageError(f"--cluster-retries {self.cluster_retries}: give 0 or more.")
        if not 0 <= self.cluster_wait < math.inf:
            raise UsageError(f"--cluster-wait {self.cluster_wait:g}: give seconds, 0 or more.")
        if self.chapter is not None and self.job != "chapter":
            raise UsageError("--chapter says which chapters a job of a batch system makes. Give --job chapter as well.")
        if self.cluster is None and _elsewhere(out):
            raise UsageError(
                f"--out {out}: is no folder of this machine, which only --cluster writes to. Choose a folder, and copy the reel "
                "there while it grows with --publish."
            )
        if not estimate:
            self.share()

    def share(self) -> Share | None:
        """Which chapters a job makes, if it makes any. Raises `UsageError` where nobody says."""
        if self.job != "chapter":
            return None
        return share_of_task(os.environ) if self.chapter is None else parse_share(self.chapter)

    @contextmanager
    def folder(self, out: str) -> Iterator[Path]:
        """The folder on this machine that is worked in: OUT, or one that is deleted at the end where OUT is elsewhere."""
        from splatreel.scene.atomic import scratch

        if _elsewhere(out):
            with scratch(Path(tempfile.gettempdir()), "splatreel-driver") as place:
                yield place
        else:
            path = local_path(out)
            assert path is not None
            yield path

    def published(self, out: str, publish: str | None) -> str | None:
        """Where the reel is copied to while it grows. Raises `UsageError` for two places."""
        if not _elsewhere(out):
            return publish
        if publish is not None:
            raise UsageError(f"--publish {publish}: the reel is already written to {out}. Leave out one of them.")
        return f"{out.rstrip('/')}/reel"

    def reconstruct(self, source: CaptureSource, folder: Path, config: Config, out: str, output: dict[str, Any]) -> str:
        """As `pipeline.reconstruct`; returns what to say at the end. folder: of `folder`. output: sound, device, progress, present."""
        from splatreel.recon.machines.run_spec import RunSpec

        progress, present = output["progress"], output["present"]
        spec = RunSpec(source, folder, config, output["sound"], output["device"])
        if self.cluster is not None:
            return self._on_cluster(spec, self.cluster, out, progress, present)
        if self.job is not None:
            from splatreel.recon.machines.batch import run_job

            return run_job(spec, self.job, self.share(), progress, present)
        from splatreel.recon.machines.here import reconstruct_here

        return playable(reconstruct_here(spec, workers=self.workers, progress=progress, present=present).reel)

    def estimated(self, source: CaptureSource, config: Config, sound: str, device: str) -> str:
        """Return how long that would take, and how much memory, in lines: here, by a batch system, or on a cluster."""
        from splatreel.cli import estimation
        from splatreel.recon.machines.run_spec import RunSpec

        spec = RunSpec(source, Path("OUT"), config, sound, device)
        if self.cluster is not None:
            return estimation.estimated_on_cluster(spec, self.cluster, self._cluster_options())
        return estimation.estimated(spec, self.workers) if self.job is None else estimation.estimated_jobs(spec)

    def _on_cluster(self, spec: RunSpec, address: str, out: str, progress: Any, present: Any) -> str:
        from splatreel.recon.machines.ray_cluster import reconstruct_on_cluster

        url = out if _elsewhere(out) else None
        result = reconstruct_on_cluster(
            spec, address, url=url, options=self._cluster_options(), progress=progress, present=present
        )
        return playable(result.reel) if url is None else f"{out.rstrip('/')}/reel: the reel is complete."

    def _cluster_options(self) -> ClusterOptions:
        from splatreel.recon.machines.ray_cluster import ClusterOptions

        return ClusterOptions(self.cluster_retries, self.cluster_wait, threads.chosen())


def _elsewhere(out: str) -> bool:
    return is_url(out) and local_path(out) is None
