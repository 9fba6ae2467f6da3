""""""

import os
import re
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.formats.ply import write_ply
from splatreel.importing.frames import open_frames
from tests.importing.films import frame, scene, write_film


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
        ([0, 1, 2, 4, 5], "1 frame is missing, the first after f2: the next one is f4"),
        ([0, 1, 5, 6, 9], "5 frames are missing, the first after f1"),
        ([0, 2, 4, 8], "1 frame is missing, the first after f4"),
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
        (["a1.ply", "other.ply"], "the name other has no number"),
        (["a1.ply", "a2.ply", "b3.ply"], "files called aN and files called bN"),
        (["a1.ply", "a01.ply"], "frame 1 twice"),
        (["f1/x.ply", "f1/y.ply"], "holds 2 files of Gaussians"),
        (["f1/x.txt"], "holds 0 files of Gaussians"),
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
    with pytest.raises(GaussiansError, match="does not exist"):
        open_frames(tmp_path / "missing")


@pytest.mark.parametrize(("name", "value"), [("sh", 1e20), ("means", 1e20), ("scales", 1e20)])
def test_implausible_value_is_named(tmp_path: Path, name: str, value: float) -> None:
    points = frame(0)
    array = getattr(points, name).copy()
    array.reshape(len(array), -1)[7, 0] = value
    folder = write_film(tmp_path, [replace(points, **{name: array})])
    with pytest.raises(GaussiansError, match=rf"frame0000\.ply: {name} of point 7 \(counted from 0\) is 1e\+20"):
        open_frames(folder).read(0)


def test_hidden_files_and_folders_are_skipped(tmp_path: Path) -> None:
    write_film(tmp_path / "flat", [frame(0), frame(1)])
    for name in ("._frame0000.ply", "._frame0001.ply", ".DS_Store"):
        (tmp_path / "flat" / name).write_bytes(b"\0" * 64)
    assert len(open_frames(tmp_path / "flat")) == 2
    for number in range(2):
        write_film(tmp_path / "deep" / f"frame_{number}", [frame(number)])
        (tmp_path / "deep" / f"frame_{number}" / "._frame0000.ply").write_bytes(b"\0" * 64)
    (tmp_path / "deep" / ".cache1").mkdir()
    assert len(open_frames(tmp_path / "deep")) == 2


def test_model_folder_is_its_newest_iteration_not_its_input(tmp_path: Path) -> None:
    (tmp_path / "input.ply").write_bytes(b"")
    for iteration in (7000, 30000):
        folder = tmp_path / "point_cloud" / f"iteration_{iteration}"
        folder.mkdir(parents=True)
        write_ply(folder / "point_cloud.ply", frame(iteration // 1000))
    for place in (tmp_path, tmp_path / "point_cloud"):
        frames = open_frames(place)
        assert len(frames) == 1
        np.testing.assert_allclose(frames.read(0).means, frame(30).means, atol=1e-5)


def test_single_file_is_a_sequence_of_one_frame(tmp_path: Path) -> None:
    write_ply(tmp_path / "scene.ply", frame(3))
    frames = open_frames(tmp_path / "scene.ply")
    assert len(frames) == 1
    np.testing.assert_allclose(frames.read(0).means, frame(3).means, atol=1e-6)


def test_files_of_two_kinds_are_refused(tmp_path: Path) -> None:
    touch(tmp_path, ["f0.ply", "f0.spz"])
    with pytest.raises(GaussiansError, match=r"holds .ply and .spz files"):
        open_frames(tmp_path)


@pytest.mark.parametrize(
    "names", [["0.ply", "1.ply"], ["film/t0.0s.ply", "film/t0.5s.ply"], ["f0/it_9/a.ply", "f1/it_9/a.ply"]]
)
def test_zip_archive(tmp_path: Path, names: list[str]) -> None:
    with zipfile.ZipFile(tmp_path / "film.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for number, name in enumerate(names):
            write_ply(tmp_path / "one.ply", frame(number))
            archive.write(tmp_path / "one.ply", name)
            archive.writestr(f"__MACOSX/._{number}.ply", b"\0" * 64)
    frames = open_frames(tmp_path / "film.zip")
    assert (len(frames), frames.fps) == (2, 2 if "s.ply" in names[0] else None)
    for number in (1, 0):
        np.testing.assert_allclose(frames.read(number).means, frame(number).means, atol=1e-6)


def test_damaged_zip_archive_is_named(tmp_path: Path) -> None:
    (tmp_path / "film.zip").write_bytes(b"PK\3\4 and nothing")
    with pytest.raises(GaussiansError, match=r"film\.zip: is not a zip archive, or damaged"):
        open_frames(tmp_path / "film.zip")
    with zipfile.ZipFile(tmp_path / "film.zip", "w") as archive:
        archive.writestr("f0.ply", b"ply\nno")
    with pytest.raises(GaussiansError, match=r"film\.zip: f0\.ply: is not a PLY file"):
        open_frames(tmp_path / "film.zip").read(0)


def test_values_are_judged_alike_in_all_frames(tmp_path: Path) -> None:
    """A frame of few points, all half transparent, looks like one without logits; the other frames decide."""
    few = replace(frame(0)[:20], opacities=np.linspace(0.55, 0.7, 20))
    folder = write_film(tmp_path, [frame(0), few])
    np.testing.assert_allclose(open_frames(folder).read(1).opacities, few.opacities, atol=1e-5)


def test_steps_between_numbers_are_remarked(tmp_path: Path) -> None:
    for number in (10, 15, 20):
        write_ply(tmp_path / f"f{number}.ply", frame(number))
    assert "go up by 5" in open_frames(tmp_path).remarks.lines()[0]
