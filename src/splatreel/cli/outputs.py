"""Output of the verbs: checks of its place, and folders of reels that belong to no run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splatreel.base.errors import UsageError
from splatreel.base.new_folder import NewFolder, new_folder

_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")
"""Start of an address, of which a path keeps one slash."""


def check_out(option: str, out: Path | str, *sources: Path | str, below: bool = True) -> None:
    """Check the place that a verb writes to, before anything is created.

    Args:
        option: Name of the option or argument, for messages.
        out: File or folder to write.
        *sources: Folders and addresses that the verb reads.
        below: False allows folders in the sources, such as masks in the folder of a capture.

    Raises:
        UsageError: `out` is an address, one of the sources, or in one.
    """
    path = Path(out)
    if _ADDRESS.match(path.as_posix()) and not Path(path.parts[0]).exists():
        address = str(out) if "://" in str(out) else path.as_posix().replace(":/", "://", 1)
        raise UsageError(
            f"{option} {address}: is an address, and this command writes to "
            "this machine only. Name a file or folder here. `splatreel publish FOLDER ADDRESS` copies a reel to an address."
        )
    for source in sources:
        if _ADDRESS.match(Path(source).as_posix()) or not Path(source).is_dir():
            continue
        place, read = path.resolve(), Path(source).resolve()
        if place == read:
            raise UsageError(f"{option} {out}: is the folder that this command reads. Choose another place.")
        if below and place.is_relative_to(read):
            raise UsageError(
                f"{option} {out}: lies in {source}, which this command reads. Choose a place outside of it."
            )


@contextmanager
def new_reel(out: Path) -> Iterator[NewFolder]:
    """Yield a folder to write a reel into: `out`, locked, which may hold what an interrupted command left.

    If `out` holds a finished reel, the folder is a temporary one. Its reel must turn out the same.

    Raises:
        UsageError: The folder holds another finished reel, or the reel of a run.
    """
    from splatreel.run.run_folder import lock_reel

    refusal = _refusal(out)
    if out.name == "reel" and (out.parent / "work").is_dir() and (out / "manifest.json").is_file():
        raise refusal
    if not has_finished_reel(out):
        with lock_reel(out):
            if not has_finished_reel(out):
                yield NewFolder(out)
                return
    with new_folder(out, refusal) as made:  # an earlier command, or another process meanwhile, finished the reel
        yield made


def has_finished_reel(folder: Path) -> bool:
    """Return whether a folder holds a reel that is not being written."""
    from splatreel.codec.reader import ReelReader

    return (folder / "manifest.json").is_file() and not ReelReader(folder).manifest.live


def _refusal(out: Path) -> UsageError:
    return UsageError(f"--out {out}: holds a reel already. Choose another folder, or delete that reel.")
