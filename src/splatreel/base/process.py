"""Process-wide settings: standard streams, threads, memory, signals and time."""

from __future__ import annotations

import ctypes
import functools
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def open_standard_streams() -> None:
    """Connect standard streams that the caller has closed to the null device.

    Otherwise the next opened file gets the descriptor of stdout, and library output is written into it.
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
    """Let idle threads of OpenMP sleep and OpenBLAS start none, so that they do not take cores from the kernels' threads.

    The runtime of a library, such as NumPy or PyTorch for RAFT, reads these variables when it loads. Call this function before.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("GOMP_SPINCOUNT", "0")
    os.environ.setdefault("KMP_BLOCKTIME", "0")


def keep_freed_memory() -> None:
    """Make glibc keep freed buffers of up to 32 MB for the next iteration, which needs buffers of the same sizes.

    Returned buffers cause page faults on one core, which take a twentieth of an iteration.
    """
    trim_threshold, mmap_threshold = -1, -3
    if libc := _glibc():
        libc.mallopt(trim_threshold, 1 << 30)
        libc.mallopt(mmap_threshold, 1 << 25)


def give_back_freed_memory() -> None:
    """Return all freed buffers to the kernel. Call this between stages, which need buffers of other sizes.

    Otherwise freed buffers fragment the heap, and the process grows from stage to stage.
    """
    if libc := _glibc():
        libc.malloc_trim(0)


@functools.cache
def _glibc() -> ctypes.CDLL | None:
    """Return glibc, or None on musl, macOS and Windows, which manage memory differently."""
    libc = ctypes.CDLL(None) if os.name == "posix" else None
    return libc if hasattr(libc, "mallopt") and hasattr(libc, "malloc_trim") else None


def peak_memory_bytes() -> int | None:
    """Return the peak resident memory of this process in bytes, or None on Windows."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def address_space_limit() -> int | None:
    """Return the limit of virtual memory (`ulimit -v`) in bytes, or None without one."""
    try:
        import resource
    except ImportError:
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit == resource.RLIM_INFINITY else limit


def check_address_space(needed: int) -> None:
    """Check the virtual memory that is left below the system's limit.

    Native libraries do not report when they reach this limit: LLVM ends the process, and OpenBLAS tries again forever.

    Args:
        needed: Bytes that a library is about to use.

    Raises:
        MemoryError: The limit leaves less.
    """
    if (limit := address_space_limit()) is None:
        return
    try:
        with open("/proc/self/statm") as file:
            used = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:  # another system than Linux
        used = 0
    if limit - used < needed:
        raise MemoryError(f"{limit - used:,} bytes of virtual memory are left, and {needed:,} are needed")


@contextmanager
def signals_held(*numbers: int) -> Iterator[None]:
    """Block signals inside the `with` block; this thread receives them afterwards.

    Child processes started in the block never receive them.

    Args:
        *numbers: Signals, such as `signal.SIGINT` for Ctrl-C, which a terminal sends to all its processes.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def steady_clock() -> Callable[[], float]:
    """Return a clock of seconds since 1970 that runs on evenly when the clock of the system is set."""
    offset = time.time() - time.monotonic()
    return lambda: offset + time.monotonic()
