"""Worker process of this machine, which makes chapters one after the other.

Heavy modules are imported only after the number of threads is set.
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

from splatreel.base.process import keep_freed_memory, quiet_threads
from splatreel.base.threads import use

if TYPE_CHECKING:
    from splatreel.run.jobs import ChapteredRun
    from splatreel.run.machines.reports import Report


def serve_chapters(spec: bytes, threads: int, gpu: str | None, connection: Connection) -> None:
    """Receive numbers of chapters until None arrives, and send reports. The last report of a chapter is `ChapterEnded`.

    Args:
        spec: A pickled `RunSpec`.
        threads: Number of threads.
        gpu: The only GPU that the process may use, as CUDA_VISIBLE_DEVICES names it; None for any.
        connection: Connection to the parent process.
    """
    _end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent gets the signal too, and decides
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
    from splatreel.run.jobs import chapter_job
    from splatreel.run.machines.reports import ChapterEnded, GroupDone, Reporter

    try:
        reporter = Reporter(chapter, connection.send)
        chapter_job(run, chapter, reporter, lambda group: connection.send(GroupDone(chapter, group)))
    except BrokenPipeError:
        raise
    except Exception as error:
        return _failed(chapter, error)
    return ChapterEnded(chapter)


def _failed(chapter: int, error: Exception) -> Report:
    from splatreel.run.machines.reports import ChapterEnded, describe_error

    return ChapterEnded(chapter, describe_error(error))


def _end_with_parent() -> None:
    """Exit when the parent process is killed. The next run continues from the checkpoints."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
