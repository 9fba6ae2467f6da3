"""Work of a cluster node: one job, in a folder that all nodes share, or in a folder of its own whose checkpoints are exchanged."""

from __future__ import annotations

import contextlib
import pickle
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from splatreel import __version__
from splatreel.base import threads
from splatreel.base.errors import InUseError, ReconstructionError
from splatreel.base.process import keep_freed_memory, quiet_threads

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
    """Reconstruct the scene that chapters share.

    Args:
        task: Instructions.
        send: Called with each report.

    Returns:
        The error as a sentence; None for success.
    """
    return _run_guarded(task, lambda: _make_scene(task, send))


def make_chapter(task: NodeTask, chapter: int, send: Callable[[object], None]) -> str | None:
    """Reconstruct one chapter. Arguments and result are those of `make_scene`."""
    return _run_guarded(task, lambda: _make_chapter(task, chapter, send))


def _make_scene(task: NodeTask, send: Callable[[object], None]) -> None:
    from splatreel.run.jobs import SCENE, scene_job
    from splatreel.run.machines.exchange import Exchange
    from splatreel.run.machines.reports import Reporter

    spec = pickle.loads(task.spec)
    with _place(task, spec.out) as out:
        exchange = None if task.url is None else Exchange(task.url, out)
        if exchange is not None:
            exchange.fetch_scene()
        with replace(spec, out=out).opened() as run:
            try:
                _wait_for_lock(lambda: scene_job(run, Reporter(0, send)))
            finally:
                if exchange is not None:
                    exchange.send_log(SCENE)
        if exchange is not None:
            exchange.send_scene()


def _make_chapter(task: NodeTask, chapter: int, send: Callable[[object], None]) -> None:
    from splatreel.run.jobs import chapter_job, chapter_name
    from splatreel.run.machines.exchange import Exchange
    from splatreel.run.machines.reports import GroupDone, Reporter, Started

    spec = pickle.loads(task.spec)
    with _place(task, spec.out) as out:
        exchange = None if task.url is None else Exchange(task.url, out)
        if exchange is not None:
            exchange.fetch_scene()  # it has the frame tables, which opening the capture needs
        with replace(spec, out=out).opened() as run:
            if exchange is not None:
                exchange.fetch_chapter(run.chapters[chapter])

            def after_group(group: int) -> None:
                if exchange is not None:
                    exchange.send_group(chapter, group)
                send(GroupDone(chapter, group))

            send(Started(chapter, socket.gethostname()))
            try:
                _wait_for_lock(lambda: chapter_job(run, chapter, Reporter(chapter, send), after_group))
            finally:
                if exchange is not None:
                    exchange.send_log(chapter_name(chapter))


def _run_guarded(task: NodeTask, action: Callable[[], None]) -> str | None:
    quiet_threads()
    threads.use(min(task.threads, threads.available()))
    keep_freed_memory()
    from splatreel.run.machines.reports import describe_error

    try:
        if task.version != __version__:
            raise ReconstructionError(
                f"This node has Splatreel {__version__}, the driver has {task.version}. Install the same version on all."
            )
        action()
    except Exception as error:
        return describe_error(error)
    return None


@contextlib.contextmanager
def _place(task: NodeTask, out: Path) -> Iterator[Path]:
    """Give the folder OUT: the one that all nodes share, or an empty one of this job, which is deleted at the end."""
    from splatreel.base.atomic import scratch

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
