"""A run on a Ray cluster: its jobs are tasks, which Ray places, and gives to another node where one is lost."""

from __future__ import annotations

import logging
import math
import pickle
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from splatreel.errors import MissingDependencyError, ReconstructionError, UsageError
from splatreel.progress import Progress, Silent, parts_of
from splatreel.recon.encode.publisher import Present, nothing_more
from splatreel.recon.jobs import ChapteredRun, has_scene, keep_tables
from splatreel.recon.machines.driver import Driver
from splatreel.recon.machines.exchange import Exchange
from splatreel.recon.machines.node import NodeTask, make_chapter, make_scene
from splatreel.recon.machines.reports import ChapterEnded, GroupDone, Noted, Reached, Report
from splatreel.recon.machines.run_spec import RunSpec
from splatreel.recon.machines.scaling import divide
from splatreel.recon.pipeline import Result, reconstruct_sequence, result_of
from splatreel.recon.run.memory import needed_memory

RETRIES = 3
"""How often a job is given to another node when its own is lost, or its process is killed."""
TIMEOUT = 10.0
"""Seconds until the head of a cluster must answer."""
INTERVAL = 0.5
"""Seconds between two looks at what nodes report."""


@dataclass(frozen=True)
class Resources:
    """What a job asks of a node. cores: also its threads. memory: bytes."""

    cores: int
    gpus: int
    memory: int


class Mailbox:
    """An actor beside the driver, to which nodes send reports."""

    def __init__(self) -> None:
        self._reports: list[Report] = []

    def put(self, report: Report) -> None:
        self._reports.append(report)

    def take(self) -> list[Report]:
        """All since it was asked before."""
        taken, self._reports = self._reports, []
        return taken


def reconstruct_on_cluster(
    spec: RunSpec,
    address: str,
    *,
    url: str | None = None,
    progress: Progress | None = None,
    present: Present = nothing_more,
) -> Result:
    """As `pipeline.reconstruct`, with the scene and the chapters made by nodes of a Ray cluster; the reel is written here.

    address: auto, or as `ray.init` takes it. All nodes read the capture by the same path. url: where checkpoints are exchanged that
    nodes make in folders of their own, as `open_folder` takes it; None: all nodes see the spec's folder, which is used as it is.
    Raises `MissingDependencyError` without ray, `UsageError` where there is no cluster, and what `here.reconstruct_here` raises.
    """
    progress = progress or Silent()
    exchange = None if url is None else Exchange(url, spec.out, progress.note)
    with connected(address) as cluster:  # nothing is read for a cluster that is not there
        if exchange is not None:
            exchange.fetch_scene()  # it may have the frame tables, by which the capture is opened
        with spec.opened() as run:
            if len(run.chapters) == 1:
                progress.note("The video is one chapter: it is made here, not on the cluster.")
                reconstruct_sequence(run, progress, present)
            else:
                with run.lock():
                    _Cluster(cluster, run, spec, url, exchange, progress).make(present)
            return result_of(run)


class _Cluster:
    """What the driver does with it. ray: the module, connected. exchange: with `url`, of the driver's own folder."""

    def __init__(
        self, ray: Any, run: ChapteredRun, spec: RunSpec, url: str | None, exchange: Exchange | None, progress: Progress
    ) -> None:
        self.ray, self.run, self.exchange, self.progress, self.url = ray, run, exchange, progress, url
        need = needed_memory(run.capture, run.config)
        self.resources, self.at_once = share_nodes(ray.nodes(), len(run.chapters), spec.device, need)
        self.task = NodeTask(pickle.dumps(spec), url, self.resources.cores)
        self.mailbox = _mailbox(ray)

    def make(self, present: Present) -> None:
        """The scene, the chapters and the reel."""
        keep_tables(self.run)
        if self.exchange is not None:
            self.exchange.send_tables()
        if not has_scene(self.run):
            self._make_scene(parts_of(self.progress, self.run.costs())[0])
        if self.exchange is not None:
            self.exchange.fetch_scene()
            self.exchange.fetch_finished()
        with Driver(self.run, self.progress, present, min(self.at_once, len(self.run.chapters)), self.url) as driver:
            self._run({chapter: (make_chapter, chapter) for chapter in driver.todo}, self._fetching(driver.hear))
            driver.finish()

    def _make_scene(self, progress: Progress) -> None:
        ended: list[str | None] = []

        def hear(report: Report) -> None:
            match report:
                case Reached(_, share):
                    progress.update(round(100 * share))
                case Noted(_, text):
                    progress.note(text)
                case ChapterEnded(_, error):
                    ended.append(error)
                case _:
                    pass

        progress.stage("building what all chapters share, on a node", 100, (0.0, 1.0))
        self._run({0: (make_scene,)}, hear)
        if ended[-1] is not None:
            raise ReconstructionError(f"{self.run.out}: the scene that chapters share failed. {ended[-1]}")
        progress.update(100)

    def _run(self, jobs: dict[int, tuple[Any, ...]], hear: Callable[[Report], None]) -> None:
        """Jobs by number, each a function and what it takes between the task and the way to send reports."""
        wanted = self.resources
        options = {"num_cpus": wanted.cores, "num_gpus": wanted.gpus, "memory": wanted.memory}
        remote = self.ray.remote(max_retries=RETRIES, scheduling_strategy="SPREAD", **options)(_on_node)
        refs = {remote.remote(self.task, self.mailbox, *job): number for number, job in jobs.items()}
        try:
            while refs:
                ready, _ = self.ray.wait(list(refs), timeout=INTERVAL)
                for report in self.ray.get(self.mailbox.take.remote()):
                    hear(report)
                for ref in ready:
                    hear(ChapterEnded(refs.pop(ref), self._outcome(ref)))
        finally:
            for ref in refs:
                self.ray.cancel(ref, force=True)

    def _outcome(self, ref: Any) -> str | None:
        """What went wrong with a job, also with the node that had it."""
        try:
            return self.ray.get(ref)
        except self.ray.exceptions.RayError as error:
            lines = str(error).strip().splitlines() or [type(error).__name__]
            return f"Ray gave it up after {1 + RETRIES} attempts: {' '.join(lines[-1].split()):.400}"

    def _fetching(self, hear: Callable[[Report], None]) -> Callable[[Report], None]:
        """With what is to be published on this machine, before it is heard of that it is there."""

        def fetch_and_hear(report: Report) -> None:
            if self.exchange is not None and isinstance(report, GroupDone):
                self.exchange.fetch_finished([report.group])
            elif self.exchange is not None and isinstance(report, ChapterEnded) and report.error is None:
                groups = self.run.chapters[report.chapter].groups
                self.exchange.fetch_finished(span.index for span in groups)
            hear(report)

        return fetch_and_hear


def _on_node(task: NodeTask, mailbox: Any, make: Callable[..., str | None], *arguments: Any) -> str | None:
    return make(task, *arguments, mailbox.put.remote)


def share_nodes(nodes: list[dict[str, Any]], chapters: int, device: str, need: int) -> tuple[Resources, int]:
    """What each job asks for, so that it fits every node that is of use, and how many are made at a time.

    nodes: as `ray.nodes()` tells of them. need: bytes of memory of a chapter. With GPUs in the cluster each job has one, unless the
    device is cpu. Raises `UsageError` where no node is of use.
    """
    alive = [node["Resources"] for node in nodes if node["Alive"] and node["Resources"].get("CPU", 0) >= 1]
    with_gpu = [node for node in alive if node.get("GPU", 0) >= 1]
    if device == "cuda" and not with_gpu:
        raise UsageError("--device cuda: no node of the Ray cluster has a GPU. Use --device cpu, or add such a node.")
    if not alive:
        raise UsageError("--cluster: no node of the Ray cluster has a CPU to offer. Add one with `ray start`.")
    memory = min(int(node.get("memory", need)) for node in alive)
    if with_gpu and device != "cpu":
        cores = min(int(node["CPU"]) // max(1, int(node["GPU"])) for node in with_gpu)
        at_once = sum(int(node["GPU"]) for node in with_gpu)
        return Resources(max(cores, 1), 1, min(need, memory)), at_once
    least = min(int(node["CPU"]) for node in alive)
    division = divide(least, math.ceil(chapters / len(alive)), max(1, memory // need))
    at_once = sum(int(node["CPU"]) // division.threads for node in alive)
    return Resources(division.threads, 0, min(need, memory)), at_once


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """The module ray, connected to a cluster that is there. Raises `MissingDependencyError` and `UsageError`."""
    try:
        import ray
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            "--cluster: the package ray is not installed. Run `pip install 'splatreel[cluster]'`."
        ) from error
    try:
        _knock(address)
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, include_dashboard=False)
    except (OSError, ValueError, RuntimeError) as error:
        raise UsageError(
            f"--cluster {address}: no Ray cluster answers there ({' '.join(str(error).split()):.300}). Start one with "
            "`ray start --head`, and give its address."
        ) from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _knock(address: str) -> None:
    """Raises OSError where nobody listens at HOST:PORT: Ray itself would try for minutes."""
    host, _, port = address.rpartition(":")
    if host and port.isdecimal() and "/" not in host:
        socket.create_connection((host.strip("[]"), int(port)), timeout=TIMEOUT).close()


def _mailbox(ray: Any) -> Any:
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=True)
    options = {"num_cpus": 0, "max_restarts": -1, "max_task_retries": -1, "scheduling_strategy": here}
    return ray.remote(Mailbox).options(**options).remote()
