"""How a process that works for long uses the machine: its threads and its memory."""

from __future__ import annotations

import ctypes
import os
import sys


def quiet_threads() -> None:
    """Threads that wait sleep instead of spinning. Next to another busy process a spinning barrier costs 4 ms a kernel.

    Read when the OpenMP runtimes load, so it must come before numba and torch.
    """
    os.environ.setdefault("GOMP_SPINCOUNT", "0")
    os.environ.setdefault("KMP_BLOCKTIME", "0")


def keep_freed_memory() -> None:
    """Have glibc keep freed buffers of up to 32 MB for the next iteration, which needs the same ones.

    Given back to the kernel, their pages are faulted in again on one core: a twentieth of an iteration.
    """
    libc = ctypes.CDLL(None) if os.name == "posix" else None
    if hasattr(libc, "mallopt"):  # not in musl, nor on macOS
        trim_threshold, mmap_threshold = -1, -3
        libc.mallopt(trim_threshold, 1 << 30)
        libc.mallopt(mmap_threshold, 1 << 25)


def peak_memory_bytes() -> int | None:
    """Most memory this process ever held resident, in bytes; None where the system does not tell (Windows)."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
