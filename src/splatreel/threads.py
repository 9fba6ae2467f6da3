"""How many threads the program uses: one number for the kernels, torch, OpenCV and the decoders, which take turns."""

from __future__ import annotations

import os
import sys

from splatreel.cgroups import cpu_quota
from splatreel.errors import UsageError

_limit: int | None = None


def available() -> int:
    """Return the number of processor cores that this process may use, by its affinity and its share of their time."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = cpu_quota()
    return cores if quota is None else max(1, min(cores, int(quota)))


def count() -> int:
    """Threads to use: what `use` said, else all cores."""
    return _limit or available()


def chosen() -> int | None:
    """Return the number that `use` was given, if it was."""
    return _limit


def use(threads: int | None) -> None:
    """Use so many threads from now on; None leaves everything as it is. Raises `UsageError` for fewer than one or more than cores.

    Libraries that are not loaded yet read it from their environment variables when they are.
    """
    global _limit
    if threads is None:
        return
    cores = available()
    if not 1 <= threads <= cores:
        raise UsageError(
            f"--threads {threads} is out of range: this process has {cores} core{'s'[: cores > 1]}. Choose 1 to {cores}, "
            "or leave it out to use all of them."
        )
    _limit = threads
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        if name != "NUMBA_NUM_THREADS" or "numba" not in sys.modules:  # numba refuses to compile where it changes later
            os.environ[name] = str(threads)
    for module, setter in (("numba", "set_num_threads"), ("torch", "set_num_threads"), ("cv2", "setNumThreads")):
        if module in sys.modules:
            getattr(sys.modules[module], setter)(threads)
