"""Previews of a run: reels of one frame that show its first keyframe while it trains.

They lie in numbered folders of OUT/work/preview. A player that shows one of them notices the next, and at last the reel of the run.
`preview_writer.py` writes them.
"""

from __future__ import annotations

import shutil
from pathlib import Path

FOLDER = Path("work", "preview")
"""Folder of the previews in the output folder of a run."""


def newest_preview(out: Path) -> Path | None:
    """Return the folder of the newest preview of a run in the folder `out`; None if there is none."""
    found = numbered_previews(out)
    return found[max(found)] if found else None


def remove_previews(out: Path) -> None:
    """Delete all previews of a run in the folder `out`."""
    shutil.rmtree(out / FOLDER, ignore_errors=True)


def numbered_previews(out: Path) -> dict[int, Path]:
    """Return the folders of all previews by their number."""
    try:
        manifests = list((out / FOLDER).glob("*/manifest.json"))
    except OSError:  # the run deletes them at this moment
        return {}
    return {int(path.parent.name): path.parent for path in manifests if path.parent.name.isdecimal()}
