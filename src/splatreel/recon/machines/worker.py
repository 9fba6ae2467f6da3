"""A process of this machine that makes the chapters that it is told to, one after the other.

What is heavy is imported once it is said how many threads there are.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from contextlib import ExitStack
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING

from splatreel.process import keep_freed_memory, quiet_threads
from splatreel.threads import use

if TYPE_CHECKING:
    from splatreel.recon.jobs import ChapteredRun
    from splatreel.recon.machines.reports import Report


def serve(spec: bytes, threads: int, gpu: str | None, connection: Connection) -> None:
    """Receive numbers of chapters until None comes; send reports of each, the last of which is `ChapterEnded`.

    spec: a pickled `RunSpec`. gpu: the only one that this process may use, as CUDA_VISIBLE_DEVICES names it; None: any.
    """
    _end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it as well, and decides
    if gpu is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = gpu
    quiet_threads()
    use(threads)
    keep_freed_memory()
    try:
        with ExitStack() as stack:
            run: ChapteredRun | None = None
            while (chapter := connection.recv()) is not None:
                try:
                    run = run or stack.enter_context(pickle.loads(spec).opened())
                except Exception as error:
                    connection.send(_failed(chapter, error))
                else:
                    connection.send(_make(run, chapter, connection))
    except (EOFError, OSError):  # the parent is gone
        os._exit(1)


def _make(run: ChapteredRun, chapter: int, connection: Connection) -> Report:
    from splatreel.recon.jobs import chapter_job
    from splatreel.recon.machines.reports import ChapterEnded, GroupDone, Reporter

    try:
        reporter = Reporter(chapter, connection.send)
        chapter_job(run, chapter, reporter, lambda group: connection.send(GroupDone(chapter, group)))
    except BrokenPipeError:
        raise
    except Exception as error:
        return _failed(chapter, error)
    return ChapterEnded(chapter)


def _failed(chapter: int, error: Exception) -> Report:
    from splatreel.recon.machines.reports import ChapterEnded, in_a_sentence

    return ChapterEnded(chapter, in_a_sentence(error))


def _end_with_parent() -> None:
    """What is half done when the parent is killed is left, as anything that is killed: the next run goes on from checkpoints."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
