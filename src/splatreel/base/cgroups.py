"""CPU and memory limits that Linux control groups, version 1 or 2, set for this process.

Containers, batch systems and services use control groups.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path, PurePosixPath

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
