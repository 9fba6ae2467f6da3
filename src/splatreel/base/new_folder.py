"""Output folders that appear when they are complete.

A command that was killed just after it finished finds its output when it runs again. It writes the output once more, into a
temporary folder, and succeeds if both are the same. Nothing that exists is overwritten.
"""

from __future__ import annotations

import filecmp
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from splatreel.base.atomic import move, scratch
from splatreel.base.errors import SplatreelError
from splatreel.base.progress import PassedOn, Progress


@dataclass
class NewFolder:
    """Folder that a command writes.

    Attributes:
        path: Folder to write into.
        existing: Folder with the output of an earlier command, which must turn out the same; None if there is none.
        refusal: Error for an existing folder that differs.
    """

    path: Path
    existing: Path | None = None
    refusal: SplatreelError | None = None
    _compared: set[Path] = field(default_factory=set)

    def check(self, *folders: str) -> None:
        """Compare files that are final with those of the existing folder, to stop early if these differ.

        Args:
            *folders: Folders of these files in the new folder; by default all of it.

        Raises:
            SplatreelError: A file is missing in the existing folder or differs: the refusal.
        """
        if self.existing is None:
            return
        if self.refusal is not None and not self.existing.is_dir():
            raise self.refusal
        for root in [self.path / name for name in folders] or [self.path]:
            for file in sorted(root.rglob("*")):
                # Names with a dot are those of files that are being written.
                if file in self._compared or file.name.startswith(".") or not file.is_file():
                    continue
                self._compare(file.relative_to(self.path))
                self._compared.add(file)

    def checked(self, progress: Progress, *folders: str) -> Progress:
        """Return a progress display that calls `check` whenever steps are done."""
        return _CheckedProgress(progress, lambda: self.check(*folders))

    def finish(self) -> None:
        """Compare all files with those of the existing folder. Call it when the output is complete.

        Raises:
            SplatreelError: A file is missing in the existing folder or differs: the refusal.
        """
        self._compared.clear()
        self.check()

    def _compare(self, name: Path) -> None:
        assert self.existing is not None
        assert self.refusal is not None
        there = self.existing / name
        if not there.is_file() or not filecmp.cmp(self.path / name, there, shallow=False):
            raise self.refusal


class _CheckedProgress(PassedOn):
    """Progress display that calls a function whenever steps are done."""

    def __init__(self, progress: Progress, check: Callable[[], None]) -> None:
        super().__init__(progress)
        self._check = check

    def update(self, done: int, **numbers: float) -> None:
        """Check, and show steps."""
        self._check()
        super().update(done, **numbers)


def is_taken(out: Path) -> bool:
    """Return whether an output folder is a file, or a folder that is not empty."""
    return out.is_symlink() or (out.exists() and (not out.is_dir() or any(out.iterdir())))


@contextmanager
def new_folder(out: Path, refusal: SplatreelError) -> Iterator[NewFolder]:
    """Yield a folder to write, which becomes `out` at the end. If `out` has files, they must be the same as the new ones.

    Args:
        out: Output folder.
        refusal: Error for an `out` that has other files.

    Raises:
        SplatreelError: `out` is a file or has other files: the refusal.
        OSError: The folder cannot be written.
    """
    existing = out if is_taken(out) else None
    if existing is not None and not out.is_dir():
        raise refusal
    with created(out.parent), scratch(out.parent, out.name) as place:
        made = NewFolder(place / "new", existing, refusal)
        made.path.mkdir()
        yield made
        if made.existing is None and not _moved(made.path, out):
            made.existing = out  # another process finished the folder meanwhile
        made.finish()


def _moved(folder: Path, out: Path) -> bool:
    """Move a folder to `out`. Return False if `out` has files by now."""
    try:
        if out.is_dir():
            out.rmdir()
        move(folder, out)
    except OSError:
        if is_taken(out):
            return False
        raise
    return True


@contextmanager
def created(folder: Path) -> Iterator[None]:
    """Create a folder and its parents. If the block fails, delete those of them that are still empty.

    Raises:
        OSError: The folder cannot be created.
    """
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for path in missing:
            with suppress(OSError):  # it has files, or another process deleted it
                path.rmdir()
        raise
