"""Streamed SOG: one scene in several detail levels, of which the finest is read."""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.formats.sog import write_sog
from splatreel.importing.frames import open_frames
from splatreel.scene.gaussians import Gaussians
from tests.golden import random_gaussians


def points(count: int, seed: int) -> Gaussians:
    return random_gaussians(np.random.default_rng(seed), count, 1, (0, 0, 0))


def write_scene(folder: Path, change: Callable[[dict[str, Any]], object] = lambda meta: None) -> list[Gaussians]:
    """Write a scene of two levels, the finer one in two files. Return the points of the files."""
    folder.mkdir(exist_ok=True)
    parts = [points(20, 0), points(60, 1), points(40, 2)]
    for name, part in zip(("1_0.sog", "0_0/meta.json", "0_1.sog"), parts, strict=True):
        if name.endswith(".json"):
            write_sog(folder / "packed.sog", part)
            with zipfile.ZipFile(folder / "packed.sog") as archive:
                archive.extractall(folder / "0_0")
            (folder / "packed.sog").unlink()
        else:
            write_sog(folder / name, part)
    left = {"lods": {"0": {"file": 1, "offset": 0, "count": 60}, "1": {"file": 0, "offset": 0, "count": 12}}}
    right = {"lods": {"0": {"file": 2, "offset": 10, "count": 30}, "1": {"file": 0, "offset": 12, "count": 8}}}
    meta = {
        "version": 1,
        "lodLevels": 2,
        "counts": [90, 20],
        "filenames": ["1_0.sog", "0_0/meta.json", "0_1.sog"],
        "tree": {"children": [left, {"children": [right]}]},
    }
    change(meta)
    (folder / "lod-meta.json").write_text(json.dumps(meta))
    return parts


@pytest.mark.parametrize("place", ["scene", "scene/lod-meta.json"])
def test_finest_level_is_one_frame(tmp_path: Path, place: str) -> None:
    write_scene(tmp_path / "scene")
    frames = open_frames(tmp_path / place)
    assert len(frames) == 1
    found = frames.read(0)
    finest = [open_frames(tmp_path / "scene" / name).read(0) for name in ("0_0/meta.json", "0_1.sog")]
    expected = np.concatenate([finest[0].means, finest[1].means[10:40]])
    np.testing.assert_array_equal(found.means, expected)
    assert "the finest of its 2 detail levels was read" in frames.remarks.lines()[0]
    assert frames.size > sum(file.stat().st_size for file in (tmp_path / "scene").glob("*.sog"))


def test_film_of_streamed_scenes_has_a_frame_for_each(tmp_path: Path) -> None:
    for number in range(3):
        write_scene(tmp_path / f"frame{number}")
    frames = open_frames(tmp_path)
    assert [len(frames.read(number)) for number in range(len(frames))] == [90, 90, 90]


def test_surroundings_and_marks_are_read(tmp_path: Path) -> None:
    write_scene(tmp_path, lambda meta: meta.update(environment="sky.sog"))
    write_sog(tmp_path / "sky.sog", points(15, 3))
    write_sog(tmp_path / "0_1.sog", points(40, 2), antialias=True)
    frames = open_frames(tmp_path)
    assert len(frames.read(0)) == 105
    assert not frames.antialias, "the first file decides"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda meta: meta.update(version=2), "version 2"),
        (lambda meta: meta.update(counts=[91, 20]), r"\[90, 20\] points"),
        (lambda meta: meta.update(lodLevels=0), "0 is not a whole number from 1"),
        (lambda meta: meta.pop("tree"), "KeyError: 'tree'"),
        (lambda meta: meta["filenames"].__setitem__(0, "../1_0.sog"), "is not a file below"),
        (lambda meta: meta["filenames"].__setitem__(2, "/etc/passwd"), "is not a file below"),
        (lambda meta: meta["tree"]["children"][0]["lods"]["0"].update(file=9), "9 is not a whole number"),
        (lambda meta: meta["tree"]["children"][0].update(lods=5), "AttributeError"),
        (lambda meta: meta["tree"].update(children=5), "TypeError"),
    ],
)
def test_damaged_descriptions_are_refused(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], said: str
) -> None:
    write_scene(tmp_path, change)
    with pytest.raises(GaussiansError, match=said) as caught:
        open_frames(tmp_path).read(0)
    assert str(tmp_path / "lod-meta.json") in str(caught.value)


def test_missing_and_short_files_are_named(tmp_path: Path) -> None:
    write_scene(tmp_path)
    write_sog(tmp_path / "0_1.sog", points(20, 2))
    with pytest.raises(GaussiansError, match=r"0_1\.sog: has 20 points, and lod-meta\.json asks for 30 from point 10"):
        open_frames(tmp_path).read(0)
    (tmp_path / "0_1.sog").unlink()
    with pytest.raises(GaussiansError, match=r"0_1\.sog: cannot be read"):
        open_frames(tmp_path).read(0)


@pytest.mark.parametrize("name", ["lod-meta.json", "tileset.json"])
def test_archives_of_parts_are_no_films(tmp_path: Path, name: str) -> None:
    write_scene(tmp_path / "scene")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for file in (tmp_path / "scene").glob("*.sog"):
            archive.write(file, file.name)
        archive.writestr(name, "{}")
    with pytest.raises(GaussiansError, match=f"{name} describes parts of one scene"):
        open_frames(tmp_path / "a.zip")


def test_sets_of_3d_tiles_are_no_films(tmp_path: Path) -> None:
    for number in range(2):
        write_sog(tmp_path / f"{number}.sog", points(20, number))
    (tmp_path / "tileset.json").write_text("{}")
    with pytest.raises(GaussiansError, match="set of 3D Tiles"):
        open_frames(tmp_path)
