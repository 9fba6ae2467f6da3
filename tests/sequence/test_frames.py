import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.errors import GaussiansError
from splatreel.scene.ply import write_ply
from splatreel.sequence.frames import open_frames
from tests.sequence.films import frame, scene, write_film


def test_frames_are_sorted_by_number(tmp_path: Path) -> None:
    for number in (10, 9, 11):
        write_ply(tmp_path / f"time_{number}.ply", frame(number))
    frames = open_frames(tmp_path)
    assert len(frames) == 3
    assert frames.size == sum(file.stat().st_size for file in tmp_path.iterdir())
    for place, number in enumerate((9, 10, 11)):
        np.testing.assert_allclose(frames.read(place).means, frame(number).means, atol=1e-6)


def test_frame_folder_uses_the_newest_iteration(tmp_path: Path) -> None:
    for number in range(3):
        for iteration in (150, 1000):
            folder = tmp_path / f"frame{number:06}" / "point_cloud" / f"iteration_{iteration}"
            folder.mkdir(parents=True)
            write_ply(folder / "point_cloud.ply", frame(number + iteration))
    frames = open_frames(tmp_path)
    assert len(frames) == 3
    np.testing.assert_allclose(frames.read(2).means, frame(1002).means, atol=1e-5)


def touch(folder: Path, names: list[str]) -> None:
    for name in names:
        (folder / name).write_bytes(b"")


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ([0, 1, 2, 4, 5], "1 frames are missing, the first of them after f2.ply: the next one is f4.ply"),
        ([0, 1, 5, 6, 9], "5 frames are missing, the first of them after f1.ply"),
        ([0, 2, 4, 8], "1 frames are missing, the first of them after f4.ply"),
    ],
)
def test_missing_frames_are_named(tmp_path: Path, numbers: list[int], said: str) -> None:
    touch(tmp_path, [f"f{number}.ply" for number in numbers])
    with pytest.raises(GaussiansError, match=re.escape(said)):
        open_frames(tmp_path)


def test_gaps_hold_repeats_frames(tmp_path: Path) -> None:
    for number in (0, 2, 4, 8):
        write_ply(tmp_path / f"f{number}.ply", frame(number))
    frames = open_frames(tmp_path, "hold")
    assert len(frames) == 5
    assert frames.size == sum(file.stat().st_size for file in tmp_path.iterdir())
    for place, number in enumerate((0, 2, 4, 4, 8)):
        np.testing.assert_allclose(frames.read(place).means, frame(number).means, atol=1e-6)


def test_huge_gaps_are_refused(tmp_path: Path) -> None:
    touch(tmp_path, ["f0.ply", "f1.ply", "f1000000000.ply"])
    with pytest.raises(GaussiansError, match="more than 1,000,000"):
        open_frames(tmp_path, "hold")


def test_constant_number_steps_are_no_gaps(tmp_path: Path) -> None:
    touch(tmp_path, ["f10.ply", "f15.ply", "f20.ply"])
    assert len(open_frames(tmp_path)) == 3


@pytest.mark.skipif(os.name != "posix", reason="links and pipes")
@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
@pytest.mark.parametrize("layout", ["f{}.ply", "f{}"])
def test_entries_that_are_no_files_are_named(tmp_path: Path, kind: str, layout: str) -> None:
    odd = tmp_path / layout.format(1)
    if layout == "f{}.ply":
        touch(tmp_path, ["f0.ply", "f2.ply"])
    else:
        for number in (0, 2):
            (tmp_path / f"f{number}").mkdir()
            (tmp_path / f"f{number}" / "a.ply").write_bytes(b"")
    if kind == "link":
        odd.symlink_to(tmp_path / "nowhere")
    elif kind == "pipe":
        os.mkfifo(odd)
    else:
        odd.mkdir()
    with pytest.raises(GaussiansError, match=re.escape(str(odd))):
        open_frames(tmp_path)


def test_one_file_needs_no_number(tmp_path: Path) -> None:
    write_ply(tmp_path / "point_cloud.ply", scene())
    assert len(open_frames(tmp_path)) == 1


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ([], "holds none of these"),
        (["a1.ply", "other.ply"], "other.ply has no number at its end"),
        (["a1.ply", "a2.ply", "b3.ply"], "files called aN and files called bN"),
        (["a1.ply", "a01.ply"], "frame 1 twice"),
        (["f1/x.ply", "f1/y.ply"], "holds 2 PLY files"),
        (["f1/x.txt"], "holds 0 PLY files"),
    ],
)
def test_files_of_unclear_order_are_refused(tmp_path: Path, names: list[str], said: str) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(GaussiansError, match=re.escape(said)) as caught:
        open_frames(tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_damaged_frame_is_named(tmp_path: Path) -> None:
    folder = write_film(tmp_path, [frame(0), frame(1)])
    file = folder / "frame0001.ply"
    file.write_bytes(file.read_bytes()[:-10])
    with pytest.raises(GaussiansError, match=r"frame0001\.ply: ends after"):
        open_frames(folder).read(1)


def test_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(GaussiansError, match="is not a folder"):
        open_frames(tmp_path / "missing")


@pytest.mark.parametrize(("name", "value"), [("sh", 1e20), ("means", 1e20), ("scales", 1e20)])
def test_implausible_value_is_named(tmp_path: Path, name: str, value: float) -> None:
    points = frame(0)
    array = getattr(points, name).copy()
    array.reshape(len(array), -1)[7, 0] = value
    folder = write_film(tmp_path, [replace(points, **{name: array})])
    with pytest.raises(GaussiansError, match=rf"frame0000\.ply: {name} of point 7 \(counted from 0\) is 1e\+20"):
        open_frames(folder).read(0)
