"""The comparison with OpenSplat, by a program in its place: what it is given, and that what it gives is measured."""

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from splatreel.kernels.image import render_image
from tests.method.captures import WallCapture, blots

PROGRAM = """#!{python}
import shutil, sys
shutil.copy({ply!r}, sys.argv[sys.argv.index("-o") + 1])
"""


@pytest.fixture
def opensplat(benchmarks: Path) -> ModuleType:
    return importlib.import_module("opensplat")


def test_both_are_measured_on_the_held_out_cameras(opensplat: ModuleType, tmp_path: Path) -> None:
    from splatreel.formats.ply import write_ply

    program, ply = tmp_path / "program", tmp_path / "made.ply"
    write_ply(ply, blots(500, [-3, -2, 0.9], [3, 2, 1.0], 0.12, 0))
    program.write_text(PROGRAM.format(python=sys.executable, ply=str(ply)))
    program.chmod(0o755)
    capture = WallCapture(1, cameras=5)
    capture.held_out = ["cam02"]
    found = opensplat.compare(capture, program, iterations=30)
    assert found["opensplat"]["points"] == 500
    assert found["ours"]["points"] > 100
    assert found["opensplat"]["psnr"] > 15  # the wall without what stands before it
    assert found["ours"]["seconds"] > found["opensplat"]["seconds"]  # which only copies a file


def test_the_project_says_where_cameras_and_points_are(opensplat: ModuleType, tmp_path: Path) -> None:
    cameras = WallCapture(1).cameras
    points, colors = np.array([[0.5, 0.25, 1.0], [1, 2, 3]]), np.array([[1.0, 0, 0.5], [0, 1, 2]])
    images = np.zeros((len(cameras), cameras[0].height, cameras[0].width, 3), np.uint8)
    opensplat.write_project(tmp_path, cameras, images, points, colors)
    frames = json.loads((tmp_path / "transforms.json").read_text())["frames"]
    for camera, frame in zip(cameras, frames, strict=True):
        pose = np.array(frame["transform_matrix"])
        np.testing.assert_allclose(pose[:3, 3], camera.center, atol=1e-5)
        np.testing.assert_allclose(-pose[:3, 2], camera.viewmat[2, :3], atol=1e-5)  # it looks along -z
        assert (frame["fl_x"], frame["cx"]) == (camera.K[0, 0], camera.K[0, 2])
        assert (tmp_path / frame["file_path"]).exists()
    kinds = [(axis, "<f4") for axis in "xyz"] + [(channel, "u1") for channel in ("red", "green", "blue")]
    rows = np.frombuffer((tmp_path / "points.ply").read_bytes().split(b"end_header\n")[1], kinds)
    assert rows[0].tolist() == (0.5, 0.25, 1.0, 255, 0, 128)
    assert rows["blue"][1] == 255


def test_what_is_drawn_well_is_measured_so(opensplat: ModuleType) -> None:
    camera, points = WallCapture(1).cameras[0], blots(100, [-1, -1, 0], [1, 1, 1], 0.2, 3)
    truth = np.clip(render_image(points, camera), 0, 1)
    found = opensplat.compared(points, [camera], (0.9 * truth)[None], render_image)
    assert 15 < found["psnr"] < 40
