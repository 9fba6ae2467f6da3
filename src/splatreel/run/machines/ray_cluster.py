"""A run on a Ray cluster: its jobs are Ray tasks. Ray places them, and gives the job of a lost node to another one.

A node works in a folder that all nodes share, or in a folder of its own whose checkpoints are exchanged.
"""

from __future__ import annotations

import logging
import math
import pickle
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from splatreel import __version__
from splatreel.base import threads
from splatreel.base.atomic import scratch
from splatreel.base.command_line import install_command
from splatreel.base.errors import InUseError, MissingDependencyError, ReconstructionError, UsageError
from splatreel.base.process import keep_freed_memory, quiet_threads
from splatreel.base.progress import Progress, Silent, parts_of
from splatreel.run.estimate import SERIAL_CHAPTER, WORTH, job_time
from splatreel.run.jobs import SCENE, ChapteredRun, chapter_job, chapter_name, has_scene, save_frame_tables, scene_job
from splatreel.run.machines.driver import Driver
from splatreel.run.machines.exchange import Exchange
from splatreel.run.machines.reports import (
    ChapterEnded,
    GroupDone,
    Noted,
    Reached,
    Report,
    Reporter,
    Started,
    describe_error,
)
from splatreel.run.output.group_writer import PresentationHook, no_presentation
from splatreel.run.pipeline import Result, RunSpec, reconstruct_sequence, result_of
from splatreel.run.requirements import needed_memory
from splatreel.run.run_logs import log_file


@dataclass(frozen=True)
class Resources:
    """Resources of a job, or of a node. The memory is in bytes."""

    cores: int
    gpus: int
    memory: int

    def slots(self, wanted: Resources) -> int:
        """Return the number of jobs that fit at a time."""
        by_gpu = self.gpus // wanted.gpus if wanted.gpus else self.cores
        return min(self.cores // wanted.cores, by_gpu, self.memory // max(wanted.memory, 1))


@dataclass(frozen=True)
class ClusterPlan:
    """Resources of all jobs.

    Attributes:
        at_once: Number of chapters that fit at a time.
    """

    scene: Resources
    chapter: Resources
    at_once: int


def share_nodes(
    nodes: list[dict[str, Any]], chapters: int, device: str, need: int, threads: int | None = None
) -> ClusterPlan:
    """Return the resources of all jobs. Nodes that cannot hold a chapter are left out. The scene takes the whole largest node.

    Args:
        nodes: Nodes as `ray.nodes()` returns them.
        chapters: Number of chapters.
        device: auto, cpu or cuda. Unless it is cpu, each job takes a GPU if the cluster has any.
        need: Bytes of memory of a job.
        threads: Threads of each job; None chooses by the nodes' cores.

    Raises:
        UsageError: No node can hold a job.
    """
    resources = [node["Resources"] for node in nodes if node["Alive"] and node["Resources"].get("CPU", 0) >= 1]
    if not resources:
        raise UsageError("--cluster: no node of the Ray cluster offers a CPU. Add one with `ray start`.")
    alive = [Resources(int(n["CPU"]), int(n.get("GPU", 0)), int(n.get("memory", need))) for n in resources]
    with_gpu = [node for node in alive if node.gpus]
    if device == "cuda" and not with_gpu:
        raise UsageError("--device cuda: no node of the Ray cluster has a GPU. Use --device cpu, or add such a node.")
    gpus = int(bool(with_gpu) and device != "cpu")
    usable = [node for node in (with_gpu if gpus else alive) if node.memory >= need]
    if not usable:
        most = max(node.memory for node in (with_gpu if gpus else alive))
        raise UsageError(
            f"--cluster: a chapter takes {need / 2**30:.1f} GiB of memory, and no node of the Ray cluster offers more than "
            f"{most / 2**30:.1f}. Add a larger node, give Ray more of it (`ray start --memory`), or choose a smaller --width."
        )
    largest = max(usable, key=lambda node: (node.cores, node.memory))
    scene = Resources(min(largest.cores, threads or largest.cores), gpus, need)
    choices = [Resources(cores, gpus, need) for cores in range(1, largest.cores + 1)]
    if threads is not None:
        choices = [Resources(min(threads, largest.cores), gpus, need)]
    slots = {choice: sum(node.slots(choice) for node in usable) for choice in choices}
    times = {
        choice: math.ceil(chapters / slots[choice]) * job_time(1.0, SERIAL_CHAPTER, choice.cores)
        for choice in choices
        if slots[choice]
    }
    best = min(times.values())
    chosen = max((choice for choice in times if times[choice] <= WORTH * best), key=lambda choice: choice.cores)
    return ClusterPlan(scene, chosen, slots[chosen])


PATIENCE = 120.0
"""Seconds that a job waits for a lock. The lock of a job that was lost with its node may remain for a while."""


@dataclass(frozen=True)
class NodeTask:
    """Instructions for a node.

    Attributes:
        spec: A pickled `RunSpec`.
        url: Address where checkpoints are exchanged; None if all nodes share the spec's folder.
        threads: Number of threads of the job.
        version: Version of Splatreel on the driver.
    """

    spec: bytes
    url: str | None
    threads: int
    version: str = __version__


def make_scene(task: NodeTask, send: Callable[[object], None]) -> str | None:
    """Reconstruct the scene that chapters share. `send` is called with each report. Return the error; None for success."""
    return _run_guarded(task, lambda: _make_scene(task, send))


def make_chapter(task: NodeTask, chapter: int, send: Callable[[object], None]) -> str | None:
    """Reconstruct one chapter. Arguments and result are those of `make_scene`."""
    return _run_guarded(task, lambda: _make_chapter(task, chapter, send))


def _make_scene(task: NodeTask, send: Callable[[object], None]) -> None:
    with _opened_on_node(task, SCENE) as (run, exchange):
        _wait_for_lock(lambda: scene_job(run, Reporter(0, send)))
        exchange.send_scene()


def _make_chapter(task: NodeTask, chapter: int, send: Callable[[object], None]) -> None:
    with _opened_on_node(task, chapter_name(chapter)) as (run, exchange):
        exchange.fetch_chapter(run.chapters[chapter])

        def after_group(group: int) -> None:
            exchange.send_group(chapter, group)
            send(GroupDone(chapter, group))

        send(Started(chapter, socket.gethostname()))
        _wait_for_lock(lambda: chapter_job(run, chapter, Reporter(chapter, send), after_group))


@contextmanager
def _opened_on_node(task: NodeTask, part: str) -> Iterator[tuple[ChapteredRun, Exchange]]:
    """Open the run in the folder of a job. Without a shared folder, the scene is fetched before, and the part's log sent after.

    Yields:
        The run, and the exchange of files.
    """
    spec = pickle.loads(task.spec)
    with _place(task, spec.out) as out:
        exchange = Exchange(task.url, out)
        exchange.fetch_scene()  # it has the frame tables, which opening the capture needs
        with replace(spec, out=out).opened() as run:
            try:
                yield run, exchange
            finally:
                exchange.send_log(part)


def _run_guarded(task: NodeTask, action: Callable[[], None]) -> str | None:
    quiet_threads()
    threads.use(min(task.threads, threads.available()))
    keep_freed_memory()
    try:
        if task.version != __version__:
            raise ReconstructionError(
                f"This node has Splatreel {__version__}, the driver has {task.version}. Install the same version on all."
            )
        action()
    except Exception as error:
        return describe_error(error)
    return None


@contextmanager
def _place(task: NodeTask, out: Path) -> Iterator[Path]:
    """Give the folder OUT: the one that all nodes share, or an empty one of this job, which is deleted at the end."""
    if task.url is None:
        yield out
        return
    with scratch(Path(tempfile.gettempdir()), "splatreel-node") as folder:
        yield folder


def _wait_for_lock(action: Callable[[], None]) -> None:
    end = time.monotonic() + PATIENCE
    while True:
        try:
            return action()
        except InUseError:
            if time.monotonic() > end:
                raise
            time.sleep(1.0)


TIMEOUT = 10.0
"""Seconds within which the head of a cluster must answer."""
INTERVAL = 0.5
"""Seconds between two looks at the reports of nodes."""


@dataclass(frozen=True)
class ClusterOptions:
    """Options of a run on a cluster.

    Attributes:
        retries: How often a job is given to another node when its node is lost or its process is killed.
        wait: Seconds to wait for a node that can hold a chapter, while an autoscaler starts it.
        threads: Threads of each job; None chooses by the nodes' cores.
    """

    retries: int = 3
    wait: float = 0.0
    threads: int | None = None


class Mailbox:
    """Actor beside the driver that collects the reports of nodes."""

    def __init__(self) -> None:
        self._reports: list[Report] = []

    def put(self, report: Report) -> None:
        """Add a report."""
        self._reports.append(report)

    def take(self) -> list[Report]:
        """Return the reports since the last call."""
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
    """Reconstruct a run like `pipeline.reconstruct`; nodes of a Ray cluster make the scene and the chapters. The reel is written here.

    All nodes read the capture by the same path or address. `address` is auto, or HOST:PORT of the cluster's head. Nodes exchange
    checkpoints at the address `url`; None if all nodes share the spec's folder.

    Raises:
        MissingDependencyError: Ray is not installed.
        UsageError: No cluster answers, or no node of it can hold a chapter.
        SplatreelError: As `local_processes.reconstruct_here` raises it.
    """
    progress = progress or Silent()
    exchange = Exchange(url, spec.out, progress.note)
    with connected(address) as cluster:  # before anything is read
        exchange.fetch_scene()  # it may have the frame tables, which opening the capture needs
        with spec.opened() as run:
            if len(run.chapters) == 1:
                progress.note("The video is one chapter. It is reconstructed on this machine, not on the cluster.")
                reconstruct_sequence(run, progress, present)
            else:
                with run.lock(), _ray_log(log_file(run.store.work, "ray")):
                    _Cluster(cluster, run, spec, url, exchange, progress, options).make(present)
            return result_of(run)


class _Cluster:
    """A connected cluster that makes a run."""

    def __init__(
        self,
        ray: Any,
        run: ChapteredRun,
        spec: RunSpec,
        url: str | None,
        exchange: Exchange,
        progress: Progress,
        options: ClusterOptions,
    ) -> None:
        self.ray = ray
        self.run = run
        self.exchange = exchange
        self.progress = progress
        self.url = url
        self.options = options
        need = needed_memory(run.capture, run.config)
        self.plan = wait_for_nodes(ray, len(run.chapters), spec.device, need, options, progress.note)
        self.spec = pickle.dumps(spec)
        self.mailbox = _mailbox(ray)

    def make(self, present: PresentationHook) -> None:
        """Make the scene, the chapters and the reel."""
        save_frame_tables(self.run)
        self.exchange.send_tables()
        if not has_scene(self.run):
            self._make_scene(parts_of(self.progress, self.run.costs())[0])
        self.exchange.fetch_scene()
        self.exchange.fetch_finished()
        with Driver(
            self.run, self.progress, present, min(self.plan.at_once, len(self.run.chapters)), self.url
        ) as driver:
            jobs = {chapter: (make_chapter, chapter) for chapter in driver.todo}
            self._run(jobs, self._fetching(driver.receive), self.plan.chapter)
            driver.finish()

    def _make_scene(self, progress: Progress) -> None:
        ended: list[str | None] = []

        def receive(report: Report) -> None:
            match report:
                case Reached(_, share):
                    progress.update(round(100 * share))
                case Noted(_, text):
                    progress.note(text)
                case ChapterEnded(_, error):
                    ended.append(error)
                case _:
                    pass

        progress.stage("training the scene that all chapters share, on a node", 100, (0.0, 1.0))
        self._run({0: (make_scene,)}, receive, self.plan.scene)
        if ended[-1] is not None:
            raise ReconstructionError(f"{self.run.out}: the scene that chapters share failed. {ended[-1]}")
        progress.update(100)

    def _run(self, jobs: dict[int, tuple[Any, ...]], receive: Callable[[Report], None], wanted: Resources) -> None:
        """Run jobs until all have ended.

        Args:
            jobs: By number, a function and its arguments between the task and the way to send reports.
            receive: Called with each report.
            wanted: Resources of each job.
        """
        options = {"num_cpus": wanted.cores, "num_gpus": wanted.gpus, "memory": wanted.memory}
        task = NodeTask(self.spec, self.url, self.options.threads or wanted.cores)
        remote = self.ray.remote(max_retries=self.options.retries, scheduling_strategy="SPREAD", **options)(_on_node)
        refs = {remote.remote(task, self.mailbox, *job): number for number, job in jobs.items()}
        try:
            while refs:
                ready, _ = self.ray.wait(list(refs), timeout=INTERVAL)
                for report in self.ray.get(self.mailbox.take.remote()):
                    receive(report)
                for ref in ready:
                    receive(ChapterEnded(refs.pop(ref), self._outcome(ref)))
        finally:
            for ref in refs:
                self.ray.cancel(ref, force=True)

    def _outcome(self, ref: Any) -> str | None:
        """Return the error of a job or of its node; None for success."""
        try:
            return self.ray.get(ref)
        except self.ray.exceptions.RayError as error:
            lines = str(error).strip().splitlines() or [type(error).__name__]
            return f"Ray gave up after {1 + self.options.retries} attempts: {' '.join(lines[-1].split()):.400}"

    def _fetching(self, receive: Callable[[Report], None]) -> Callable[[Report], None]:
        """Return a receiver that fetches finished groups to this machine before it hands their report on."""

        def fetch_and_receive(report: Report) -> None:
            if isinstance(report, GroupDone):
                self.exchange.fetch_finished([report.group])
            elif isinstance(report, ChapterEnded) and report.error is None:
                groups = self.run.chapters[report.chapter].groups
                self.exchange.fetch_finished(span.index for span in groups)
            receive(report)

        return fetch_and_receive


def _on_node(task: NodeTask, mailbox: Any, make: Callable[..., str | None], *arguments: Any) -> str | None:
    return make(task, *arguments, mailbox.put.remote)


def wait_for_nodes(
    ray: Any, chapters: int, device: str, need: int, options: ClusterOptions, tell: Callable[[str], None]
) -> ClusterPlan:
    """Return how the jobs share a cluster, once one of its nodes can hold a job. An autoscaler is asked for such a node.

    Arguments are those of `share_nodes`. `tell` receives a message if there is something to wait for.

    Raises:
        UsageError: No such node appeared in time.
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
def connected(address: str) -> Iterator[Any]:
    """Give the module ray, connected to a running cluster. `address` is auto, or HOST:PORT.

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
            f"--cluster: the package ray is not installed. Run `{install_command('cluster')}`."
        ) from error
    with _ray_log(None):
        try:
            _check_port(address)
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
    """Send the messages of Ray's own logger, such as lost nodes, to a file, and not to the terminal. None drops them."""
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


def _check_port(address: str) -> None:
    """Raise OSError if no process listens at HOST:PORT. Ray itself would try for minutes."""
    host, _, port = address.rpartition(":")
    if host and port.isdecimal() and "/" not in host:
        socket.create_connection((host.strip("[]"), int(port)), timeout=TIMEOUT).close()


def _mailbox(ray: Any) -> Any:
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=True)
    options = {"num_cpus": 0, "max_restarts": -1, "max_task_retries": -1, "scheduling_strategy": here}
    return ray.remote(Mailbox).options(**options).remote()
