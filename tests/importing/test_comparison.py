"""Comparison of a reel with its source sequence by cameras that see part of it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.cli.main import main
from splatreel.formats.ply import read_ply
from splatreel.importing import comparison
from splatreel.play.timeline import open_reel
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.importing.films import cameras, frame, write_film
from tests.importing.test_viewpoints import entry

FAR = np.array([448_000.0, 5_411_000.0, 300.0])
"""Position on a map, in meters."""


def write_double(path: Path, points: Gaussians, offset: np.ndarray) -> None:
    """Write a PLY file with 64-bit positions moved by an offset."""
    names = ["f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += [f"{part}_{i}" for part, count in (("scale", 3), ("rot", 4)) for i in range(count)]
    table = np.zeros(len(points), [(name, "<f8") for name in "xyz"] + [(name, "<f4") for name in names])
    for axis, name in enumerate("xyz"):
        table[name] = points.means[:, axis].astype(np.float64) + offset[axis]
    for i in range(3):
        table[f"f_dc_{i}"], table[f"scale_{i}"] = points.sh[:, 0, i], np.log(points.scales[:, i])
    for i in range(4):
        table[f"rot_{i}"] = points.quats[:, i]
    table["opacity"] = np.log(points.opacities / (1 - points.opacities))
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    lines += [f"property {'double' if name in 'xyz' else 'float'} {name}" for name in table.dtype.names or ()]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + table.tobytes())


def entries(views: list[Camera], offset: np.ndarray) -> str:
    documents = [entry(camera, index) for index, camera in enumerate(views)]
    for document in documents:
        document["position"] = (np.array(document["position"]) + offset).tolist()
    return json.dumps(documents)


def imported(tmp_path: Path, offset: np.ndarray, capsys: pytest.CaptureFixture[str]) -> str:
    film = tmp_path / "film"
    film.mkdir()
    for number in range(2):
        write_double(film / f"frame{number}.ply", frame(number), offset)
    (tmp_path / "cameras.json").write_text(entries(cameras(), offset))
    given = ["--out", str(tmp_path / "reel"), "--cameras", str(tmp_path / "cameras.json")]
    assert main(["import", str(film), *given]) == 0
    return capsys.readouterr().out


def test_positions_far_from_the_origin_are_shifted_and_exported_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = imported(tmp_path, FAR, capsys)
    assert float(said.split("images have ")[1].split(" dB")[0]) > 40
    assert "Positions are stored relative to 44" in said
    manifest = json.loads((tmp_path / "reel" / "manifest.json").read_text())
    assert np.abs(np.array(manifest["origin"]) - FAR).max() < 5
    assert np.abs(np.array(manifest["bounds"])).max() < 5
    export = ["export", str(tmp_path / "reel"), "--frame", "0"]
    assert main([*export, "--out", str(tmp_path / "f.ply"), "--up", "capture"]) == 0
    back = read_ply(tmp_path / "f.ply", FAR).means
    np.testing.assert_allclose(np.sort(back, axis=0), np.sort(frame(0).means, axis=0), atol=0.01)
    assert main([*export, "--out", str(tmp_path / "f.spz")]) == 0
    assert "which .spz files cannot hold" in capsys.readouterr().out


def test_sequence_near_the_origin_has_no_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = imported(tmp_path, np.zeros(3), capsys)
    assert float(said.split("images have ")[1].split(" dB")[0]) > 40
    assert "Warning" not in said


def test_comparison_names_a_low_rate_as_the_cause(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(comparison, "CLOSE", 60.0)
    film = write_film(tmp_path / "film", [frame(0)])
    assert main(["import", str(film), "--out", str(tmp_path / "reel"), "--rate", "low"]) == 0
    said = capsys.readouterr().out
    assert float(said.split("images have ")[1].split(" dB")[0]) < 60
    assert "the rate is low, and --rate high loses less" in said


def away(camera: Camera) -> Camera:
    """Return the camera rotated by half a turn, so that it sees nothing."""
    return replace(camera, viewmat=np.diag([-1.0, 1, -1, 1]) @ camera.viewmat)


def test_blind_cameras_are_refused_before_writing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film, file = write_film(tmp_path / "film", [frame(0)]), tmp_path / "cameras.json"
    file.write_text(entries([away(camera) for camera in cameras()], np.zeros(3)))
    assert main(["import", str(film), "--out", str(tmp_path / "reel"), "--cameras", str(file)]) == 1
    assert f"the cameras of {file} see nothing of the sequence" in capsys.readouterr().err
    assert not (tmp_path / "reel").exists()


def test_blind_camera_is_named_and_skipped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film, file = write_film(tmp_path / "film", [frame(0)]), tmp_path / "cameras.json"
    views = cameras()
    file.write_text(entries([away(views[0]), *views[1:]], np.zeros(3)))
    assert main(["import", str(film), "--out", str(tmp_path / "reel"), "--cameras", str(file)]) == 0
    said = capsys.readouterr().out
    assert "Cameras that see nothing of the film: cam0." in said
    assert float(said.split("images have ")[1].split(" dB")[0]) < 90


def test_positions_are_centered_before_rounding(tmp_path: Path) -> None:
    write_double(tmp_path / "a.ply", frame(0), FAR)
    np.testing.assert_allclose(read_ply(tmp_path / "a.ply", FAR).means, frame(0).means, atol=1e-6)
    assert np.abs(read_ply(tmp_path / "a.ply").means - FAR - frame(0).means).max() > 0.1


def with_far_point(number: int, place: list[float]) -> Gaussians:
    points = frame(number)
    means = points.means.copy()
    means[7] = place
    return replace(points, means=means)


@pytest.mark.parametrize("distance", [1e4, 1e6, 1e9])
def test_a_far_point_costs_the_others_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], distance: float
) -> None:
    file = tmp_path / "cameras.json"
    write_film(tmp_path / "film", [with_far_point(number, [distance, 0, 0]) for number in range(2)])
    file.write_text(entries(cameras(), np.zeros(3)))
    assert main(["import", str(tmp_path / "film"), "--out", str(tmp_path / "reel"), "--cameras", str(file)]) == 0
    said = capsys.readouterr().out
    assert float(said.split("images have ")[1].split(" dB")[0]) > 45
    shown = open_reel(tmp_path / "reel").at(0).means
    assert np.abs(shown).max() == pytest.approx(distance, rel=1e-3)


def test_comparison_names_moving_distant_points_as_the_cause(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "cameras.json"
    write_film(tmp_path / "film", [with_far_point(number, [1e6, 1e6 * number, 0]) for number in range(2)])
    file.write_text(entries(cameras(), np.zeros(3)))
    assert main(["import", str(tmp_path / "film"), "--out", str(tmp_path / "reel"), "--cameras", str(file)]) == 0
    assert "1 points, such as number 7 (counted from 0)" in capsys.readouterr().out
