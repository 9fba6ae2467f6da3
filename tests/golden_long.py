"""The golden reels of version 2, for readers in any language; `python -m tests.golden` writes them anew, with the others.

tests/data/golden-long      10 groups of 3 frames in two renditions, overlap 1, in two chapters of five: 6 static points are of
                            both, 4 are born with each chapter and 2 with its second group, and retired with it. Pages of two
                            groups: four, of which the third is of both chapters.
tests/data/golden-window    the same in one rendition, still live, after groups 0 to 3 were dropped

expected.json               what is decoded and shown, sampled as in `tests.golden`; `living`: by group its layers, in order
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from splatreel.codec.reader import ReelReader
from splatreel.config import EncodeConfig, Rate
from tests.codec.reels import add_chapter_group, new_writer
from tests.golden import decoded, sampled

DATA = Path(__file__).parent / "data"
LONG, WINDOW = DATA / "golden-long", DATA / "golden-window"
TIMES = (0.0, 0.05, 0.2, 0.25, 0.65, 0.85, 1.0, 1.05, 1.1, 1.45, 1.95, 9.0)
GROUPS, CHAPTER, PAGE = 10, 5, 2


def write_long(path: Path) -> None:
    """Write `golden-long` into a directory."""
    _grow(path, ("high", "low")).finish()


def write_window(path: Path) -> None:
    """Write `golden-window` into a directory."""
    _grow(path, ()).drop_before(GROUPS // 2)


def _grow(path: Path, renditions: tuple[Rate, ...]):
    if path.exists():
        shutil.rmtree(path)
    writer = new_writer(path, config=EncodeConfig(coarseness=1.0, renditions=renditions), page=PAGE)
    for index in range(GROUPS):
        add_chapter_group(writer, index, CHAPTER)
    return writer


def expected(path: Path) -> dict:
    """Return the content of `expected.json` for the reel in a directory."""
    manifest = ReelReader(path).manifest
    living = {g.group: [manifest.layers[i].uri for i in manifest.living_layers(g.group)] for g in manifest.groups}
    return sampled(decoded(path, TIMES), 12, TIMES) | {"living": {str(group): uris for group, uris in living.items()}}


def write_all() -> None:
    """Write both reels and their expected content."""
    for path, write in ((LONG, write_long), (WINDOW, write_window)):
        write(path)
        text = json.dumps(expected(path), separators=(",", ":"))
        (path / "expected.json").write_text(text + "\n")
