"""A run on a Ray cluster: its jobs are tasks, which Ray places, and gives to another node where one is lost."""

from __future__ import annotations

import logging
import pickle
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatreel.errors import MissingDependencyError, ReconstructionError, UsageError
from splatreel.progress import Progress, Silent, parts_of
from splatreel.recon.encode.group_writer import PresentationHook, no_presentation
from splatreel.recon.jobs import ChapteredRun, has_scene, keep_tables
from splatreel.recon.machines.driver import Driver
from splatreel.recon.machines.exchange import Exchange
from splatreel.recon.machines.node import NodeTask, make_chapter, make_scene
from splatreel.recon.machines.ray_nodes import ClusterPlan, Resources, share_nodes
from splatreel.recon.machines.reports import ChapterEnded, GroupDone, Noted, Reached, Report
from splatreel.recon.machines.run_spec import RunSpec
from splatreel.recon.pipeline import Result, reconstruct_sequence, result_of
from splatreel.recon.run.job_log import log_file
from splatreel.recon.run.memory import needed_memory

TIMEOUT = 10.0
"""Seconds until the head of a cluster must answer."""
INTERVAL = 0.5
"""Seconds between two looks at what nodes report."""


@dataclass(frozen=True)
class ClusterOptions:
    """How a cluster is used.

    Attributes:
        retries: How often a job is given to another node when its own is lost, or its process is killed.
        wait: Seconds to wait for a node that can hold a chapter, as an autoscaler starts it.
        threads: Of each job; None leaves it to the nodes' cores.
    """

    retries: int = 3
    wait: float = 0.0
    threads: int | None = None


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
    options: ClusterOptions = ClusterOptions(),
    progress: Progress | None = None,
    present: PresentationHook = no_presentation,
) -> Result:
    """As `pipeline.reconstruct`, with the scene and the chapters made by nodes of a Ray cluster; the reel is written here.

    Args:
        spec: The run. All nodes read its capture by the same path or address.
        address: auto, or HOST:PORT of the cluster's head.
        url: Where checkpoints are exchanged that nodes make in folders of their own, as `open_folder` takes it; None: all nodes see
            the spec's folder, which is used as it is.
        options: How the cluster is used.
        progress: Shows how far all nodes are.
        present: Adds what a reel has beside its points.

    Raises:
        MissingDependencyError: Ray is not installed.
        UsageError: There is no cluster, or no node of it can hold a chapter.
        SplatreelError: Whatever `here.reconstruct_here` raises.
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
                with run.lock(), _ray_log(log_file(run.store.work, "ray")):
                    _Cluster(cluster, run, spec, url, exchange, progress, options).make(present)
            return result_of(run)


class _Cluster:
    """What the driver does with it. ray: the module, connected. exchange: with `url`, of the driver's own folder."""

    def __init__(
        self,
        ray: Any,
        run: ChapteredRun,
        spec: RunSpec,
        url: str | None,
        exchange: Exchange | None,
        progress: Progress,
        options: ClusterOptions,
    ) -> None:
        self.ray, self.run, self.exchange, self.progress, self.url = ray, run, exchange, progress, url
        self.options = options
        need = needed_memory(run.capture, run.config)
        self.plan = wait_for_nodes(ray, len(run.chapters), spec.device, need, options, progress.note)
        self.spec = pickle.dumps(spec)
        self.mailbox = _mailbox(ray)

    def make(self, present: PresentationHook) -> None:
        """The scene, the chapters and the reel."""
        keep_tables(self.run)
        if self.exchange is not None:
            self.exchange.send_tables()
        if not has_scene(self.run):
            self._make_scene(parts_of(self.progress, self.run.costs())[0])
        if self.exchange is not None:
            self.exchange.fetch_scene()
            self.exchange.fetch_finished()
        with Driver(
            self.run, self.progress, present, min(self.plan.at_once, len(self.run.chapters)), self.url
        ) as driver:
            jobs = {chapter: (make_chapter, chapter) for chapter in driver.todo}
            self._run(jobs, self._fetching(driver.hear), self.plan.chapter)
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
        self._run({0: (make_scene,)}, hear, self.plan.scene)
        if ended[-1] is not None:
            raise ReconstructionError(f"{self.run.out}: the scene that chapters share failed. {ended[-1]}")
        progress.update(100)

    def _run(self, jobs: dict[int, tuple[Any, ...]], hear: Callable[[Report], None], wanted: Resources) -> None:
        """Jobs by number, each a function and what it takes between the task and the way to send reports."""
        options = {"num_cpus": wanted.cores, "num_gpus": wanted.gpus, "memory": wanted.memory}
        task = NodeTask(self.spec, self.url, self.options.threads or wanted.cores)
        remote = self.ray.remote(max_retries=self.options.retries, scheduling_strategy="SPREAD", **options)(_on_node)
        refs = {remote.remote(task, self.mailbox, *job): number for number, job in jobs.items()}
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
            return f"Ray gave it up after {1 + self.options.retries} attempts: {' '.join(lines[-1].split()):.400}"

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


def wait_for_nodes(
    ray: Any, chapters: int, device: str, need: int, options: ClusterOptions, tell: Callable[[str], None]
) -> ClusterPlan:
    """Return how the jobs share a cluster, once it has a node that can hold one.

    An autoscaler is asked for such a node. Raises `UsageError` where none comes in time.
    """
    end, asked = time.monotonic() + options.wait, False
    while True:
        try:
            return share_nodes(ray.nodes(), chapters, device, need, options.threads)
        except UsageError:
            if time.monotonic() >= end:
                raise
        if not asked:
            tell(f"Waiting up to {options.wait:g} s for a node of the cluster that can hold a chapter")
            _ask_autoscaler(ray, need, options.threads or 1)
            asked = True
        time.sleep(INTERVAL)


def _ask_autoscaler(ray: Any, need: int, cores: int) -> None:
    from ray.autoscaler.sdk import request_resources

    request_resources(bundles=[{"CPU": cores, "memory": need}])


@contextmanager
def connected(address: str, log: Path | None = None) -> Iterator[Any]:
    """Give the module ray, connected to a cluster that is there.

    Args:
        address: auto, or HOST:PORT.
        log: Where what Ray says goes, such as of nodes that are lost; nowhere by default.

    Raises:
        MissingDependencyError: Ray is not installed.
        UsageError: No cluster answers.
    """
    if address.startswith("ray://"):
        raise UsageError(
            f"--cluster {address}: Ray Client is not supported, since the driver would have no node of its own. Run the command on a "
            "machine of the cluster with --cluster auto, or submit it there with `ray job submit`."
        )
    try:
        import ray
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            "--cluster: the package ray is not installed. Run `pip install 'splatreel[cluster]'`."
        ) from error
    with _ray_log(log):
        try:
            _knock(address)
            ray.init(address=address, log_to_driver=False, configure_logging=False, include_dashboard=False)
        except (OSError, ValueError, RuntimeError) as error:
            raise UsageError(
                f"--cluster {address}: no Ray cluster answers there ({' '.join(str(error).split()):.300}). Start one with "
                "`ray start --head`, and give its address."
            ) from error
        try:
            yield ray
        finally:
            ray.shutdown()


@contextmanager
def _ray_log(path: Path | None) -> Iterator[None]:
    """Send what Ray's own logger says to a file, and to no terminal."""
    logger = logging.getLogger("ray")
    before, propagated, level = list(logger.handlers), logger.propagate, logger.level
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
    handler = logging.NullHandler() if path is None else logging.FileHandler(path, encoding="utf-8", delay=True)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    logger.handlers, logger.propagate = [handler], False
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        handler.close()
        logger.handlers, logger.propagate = before, propagated
        logger.setLevel(level)


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
