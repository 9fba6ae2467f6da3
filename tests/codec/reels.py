"""Small reels for tests."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.opus_sound import EncodedSound, write_sound
from splatreel.codec.presentation import Vec3
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.scene.group import Group
from tests.golden import camera, random_gaussians, random_motion

CONFIG = EncodeConfig(codec="h265", sh_entries=16)
QUICK = EncodeConfig(coarseness=1.0)
HOW = "config", "resume", "first_group", "page"
"""Arguments of a writer that are not fields of its header."""


def new_header(**changes) -> ReelHeader:
    """Return the header of a reel: 10 frames per second, overlap 1."""
    settings: dict[str, Any] = {
        "fps": 10,
        "group_length": 2,
        "overlap": 1,
        "sh_degree": 1,
        "bounds": np.array([[-1.0, -1, -1], [1, 1, 1]]),
        "up": np.array([0.0, -1, 0]),
        "camera": camera("start", 0),
        "cameras": [camera("a", 1)],
    }
    return ReelHeader(**(settings | changes))


def new_writer(path: Path, **changes) -> ReelWriter:
    """Return a writer with default settings and the header of `new_header`."""
    how = {name: changes.pop(name) for name in HOW if name in changes}
    return ReelWriter(path, new_header(**changes), **({"config": CONFIG} | how))  # pyright: ignore[reportArgumentType]


def points(count: int, seed: int = 0, degree: int = 1):
    return random_gaussians(np.random.default_rng(seed), count, degree, (0, 0, 0))


def new_group(
    index: int, dynamic: int, alive: int | np.ndarray, frames: int = 3, first_frame: int | None = None
) -> Group:
    """Return a group of dynamic points; `alive` has flags, or the number of static points, all alive."""
    moving = points(dynamic, seed=100 + index)
    dx, dq = random_motion(np.random.default_rng(index), moving, frames)
    flags = np.ones(alive, bool) if isinstance(alive, int) else alive
    return Group(index, 2 * index if first_frame is None else first_frame, moving, dx, dq, flags)


def write_reel(path: Path, groups: int = 2) -> Path:
    """Write 20 static points born at group 0, 10 at group 1, and 15 dynamic points per group."""
    writer = new_writer(path)
    static = 0
    for index in range(groups):
        born = (20, 10)[index] if index < 2 else 0
        writer.add_layer(index, 2 * index, points(born, seed=index))
        static += born
        writer.add_group(new_group(index, 15, static))
    writer.finish()
    return path


def add_chapter_group(writer: ReelWriter, index: int, chapter: int) -> None:
    """Add a group of a reel in chapters: 6 common static points, 4 per chapter from its first group on, and 2 from its second on."""
    first = index // chapter * chapter
    if index == 0:
        writer.add_layer(0, 0, points(6, seed=1000))
    born = {first: 4, first + 1: 2}.get(index, 0)
    writer.add_layer(index, 2 * index, points(born, seed=2000 + index), until=first + chapter)
    static = 10 if index == first else 12
    writer.add_group(new_group(index, 3, np.arange(static) % 5 != index % 5))


def write_chapters(path: Path, groups: int = 12, chapter: int = 4, page: int = 2, **changes) -> Path:
    """Write a finished reel in chapters with small pages (`add_chapter_group`)."""
    writer = new_writer(path, **({"config": QUICK, "page": page} | changes))
    for index in range(groups):
        add_chapter_group(writer, index, chapter)
    writer.finish()
    return path


def give_sound(reel: Path, sound: EncodedSound | None, position: Vec3 | None = None) -> None:
    """Replace the sound of a finished reel of `write_reel`."""
    writer = new_writer(reel, resume=True)
    write_sound(writer, sound, position)
    writer.finish()


def edit_manifest(path: Path, change) -> None:
    """Apply a change to the parsed manifest and write it back."""
    file = path / "manifest.json"
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))


def replace_file(path: Path, kind: str, index: int, data: bytes) -> None:
    """Replace a file and update the manifest, as in a forged reel."""

    def change(document):
        entry = document[kind][index]
        entry["bytes"], entry["sha256"] = len(data), hashlib.sha256(data).hexdigest()
        (path / entry["uri"]).write_bytes(data)

    edit_manifest(path, change)
