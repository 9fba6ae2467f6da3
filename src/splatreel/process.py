"""How a process that works for long uses the machine: its threads and its memory."""

from __future__ import annotations

import ctypes
import functools
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager


def open_standard_streams() -> None:
    """Connect those of stdin, stdout and stderr that the caller has closed to nothing.

    Otherwise the next file that is opened takes the place of stdout, and what a library prints lands in it.
    """
    if None not in (sys.stdin, sys.stdout, sys.stderr):
        return
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(handle, True)
    os.close(handle)
    sys.stdin = sys.stdin or os.fdopen(0, encoding="utf-8", closefd=False)
    sys.stdout = sys.stdout or os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", encoding="utf-8", closefd=False)


def quiet_threads() -> None:
    """Let torch's threads sleep while they wait, so that they do not keep the kernels' threads from the cores.

    Torch's OpenMP runtime reads these variables when it loads, so this must come before torch.
    """
    os.environ.setdefault("GOMP_SPINCOUNT", "0")
    os.environ.setdefault("KMP_BLOCKTIME", "0")


def keep_freed_memory() -> None:
    """Have glibc keep freed buffers of up to 32 MB for the next iteration, which needs the same ones.

    Given back to the kernel, their pages are faulted in again on one core: a twentieth of an iteration.
    """
    trim_threshold, mmap_threshold = -1, -3
    if libc := _glibc():
        libc.mallopt(trim_threshold, 1 << 30)
        libc.mallopt(mmap_threshold, 1 << 25)


def give_back_freed_memory() -> None:
    """Give all freed buffers back to the kernel; for between stages, which need others.

    Kept, they would lie scattered between what lives on, too small for the next ones, and a process would grow from stage to stage.
    """
    if libc := _glibc():
        libc.malloc_trim(0)


@functools.cache
def _glibc() -> ctypes.CDLL | None:
    """None on musl, macOS and Windows, whose memory is another matter."""
    libc = ctypes.CDLL(None) if os.name == "posix" else None
    return libc if hasattr(libc, "mallopt") and hasattr(libc, "malloc_trim") else None


def peak_memory_bytes() -> int | None:
    """Most memory this process ever held resident, in bytes; None where the system does not tell (Windows)."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back. It goes to all processes of a terminal: those that are started meanwhile never get it, this one does later."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
