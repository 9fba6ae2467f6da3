"""Process-wide settings and limits: standard streams, threads, memory, control groups, signals, time, and numba's cache."""

from __future__ import annotations

import ctypes
import functools
import os
import signal
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath


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


MOUNTED = Path("/sys/fs/cgroup")
OWN = Path("/proc/self/cgroup")
UNLIMITED = 1 << 60
"""Bytes at or above which version 1 means that there is no limit."""


def cpu_quota() -> float | None:
    """Return the number of processors whose time this process may use, or None without a limit."""
    found: list[float] = []
    for group in _groups("cpu"):
        quota, period, *_ = [*_words(group / "cpu.max"), "", ""]
        if not quota:
            quota, period = _word(group / "cpu.cfs_quota_us"), _word(group / "cpu.cfs_period_us")
        if _is_number(quota) and _is_number(period) and int(period) > 0:
            found.append(int(quota) / int(period))
    return min(found, default=None)


def memory_limit() -> int | None:
    """Return the lowest memory limit of this process's groups in bytes, or None without a limit."""
    return min((limit for _, limit in _groups_with_memory_limit()), default=None)


def free_memory() -> int | None:
    """Return the bytes left below the memory limits, or None without a limit.

    File pages count as free, because the kernel drops them first.
    """
    return min((max(limit - _used_bytes(group), 0) for group, limit in _groups_with_memory_limit()), default=None)


def _groups_with_memory_limit() -> Iterator[tuple[Path, int]]:
    """Yield each group that has a memory limit, with the limit in bytes."""
    for group in _groups("memory"):
        for name in ("memory.max", "memory.limit_in_bytes"):
            word = _word(group / name)
            if _is_number(word) and int(word) < UNLIMITED:
                yield group, int(word)


def _used_bytes(group: Path) -> int:
    """Return the bytes that a group holds, without file pages."""
    for name, prefix in (("memory.current", ""), ("memory.usage_in_bytes", "total_")):
        word = _word(group / name)
        if not _is_number(word):
            continue
        pages = 0
        counts = _words(group / "memory.stat")
        for kind, count in zip(counts[::2], counts[1::2], strict=False):
            if kind in (f"{prefix}inactive_file", f"{prefix}active_file") and _is_number(count):
                pages += int(count)
        return max(int(word) - pages, 0)
    return 0


def _groups(controller: str) -> Iterator[Path]:
    """Yield the folders of this process's own group and of its visible parent groups."""
    for line in _lines(OWN):
        number, controllers, path = (*line.split(":", 2), "", "")[:3]
        if number == "0" and not controllers:
            places = [MOUNTED, MOUNTED / "unified"]
        elif controller in controllers.split(","):
            places = [MOUNTED / controllers, MOUNTED / controller]
        else:
            continue
        for place in places:
            if place.is_dir():
                own = PurePosixPath(path.lstrip("/"))
                yield from (folder for part in (own, *own.parents) if (folder := place / part).is_dir())
                break


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return []


def _words(path: Path) -> list[str]:
    return " ".join(_lines(path)).split()


def _word(path: Path) -> str:
    return (_words(path) or [""])[0]


def _is_number(word: str) -> bool:
    return word.isascii() and word.isdecimal()


PACKAGE = Path(__file__).parents[1]
VARIABLE = "NUMBA_CACHE_DIR"


@functools.cache
def choose_compile_cache() -> None:
    """Choose a writable folder for numba's cache: numba's own, else one in the temporary folder, else turn the cache off.

    Call this before the first kernel is imported. Child processes inherit the choice.
    """
    chosen = os.environ.get(VARIABLE)
    if chosen and _writable(Path(chosen)):
        return
    if not chosen and (_writable(PACKAGE / "__pycache__") or _writable(_user_cache())):
        return
    private = _private_folder()
    if private is None:
        _cache_nothing()
        return
    os.environ[VARIABLE] = str(private)
    if "numba" in sys.modules:  # numba has read the variable already
        sys.modules["numba"].config.CACHE_DIR = str(private)


def _user_cache() -> Path:
    """Return numba's cache folder for the user on Linux. On other systems it is elsewhere in the home folder."""
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))


def _writable(folder: Path) -> bool:
    """Return whether files can be created in a folder, or whether a missing folder can be created."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _private_folder() -> Path | None:
    """Return a folder in the temporary folder that only this user can write to, since the cache holds code; None if impossible."""
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    try:
        folder = Path(tempfile.gettempdir()) / f"splatreel-numba-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    mine = not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not found.st_mode & 0o077)
    return folder if mine and stat.S_ISDIR(found.st_mode) and _writable(folder) else None


def _cache_nothing() -> None:
    """Turn numba's cache off: every process compiles anew. Numba has no setting for this, so its method is replaced."""
    from numba.core.dispatcher import Dispatcher

    Dispatcher.enable_caching = lambda self: None
