"""Remarks on input that was converted or dropped. The user sees them, so that nothing is changed silently."""

from __future__ import annotations

from pathlib import Path


class Remarks:
    """Collection of remarks, by text and file. A file that is read twice counts once."""

    def __init__(self) -> None:
        self._counts: dict[str, dict[str, int]] = {}

    def add(self, text: str, source: str | Path, count: int = 1) -> None:
        """Add a remark.

        Args:
            text: Sentence without its full stop; `{}` is replaced by the sum of the counts.
            source: File that the remark is about.
            count: Number of points, or 1.
        """
        self._counts.setdefault(text, {})[str(source)] = count

    def lines(self) -> list[str]:
        """Return one line per remark, with the number of files and the first of them."""
        lines = []
        for text, counts in self._counts.items():
            first = next(iter(counts))
            where = first if len(counts) == 1 else f"{len(counts)} files, the first of them {first}"
            lines.append(f"{text.format(f'{sum(counts.values()):,}')} ({where}).")
        return lines

    def take(self, others: Remarks, source: str) -> None:
        """Add the remarks of another collection, all of them about one file."""
        for text, counts in others._counts.items():
            self.add(text, source, sum(counts.values()))
