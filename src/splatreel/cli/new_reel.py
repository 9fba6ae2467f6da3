"""Output of the verbs that write a reel which belongs to no run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splatreel.base.errors import UsageError
from splatreel.base.new_folder import NewFolder, new_folder


@contextmanager
def new_reel(out: Path) -> Iterator[NewFolder]:
    """Yield a folder to write a reel into: `out`, locked, which may hold what an interrupted command left.

    If `out` holds a finished reel, the folder is a temporary one. Its reel must turn out the same.

    Raises:
        UsageError: The folder holds another finished reel, or the reel of a run.
    """
    from splatreel.run.run_lock import lock_reel

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
