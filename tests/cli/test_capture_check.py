"""`splatreel capture check` on correct poses and on poses that the images do not confirm."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.cli.main import main
from splatreel.scene.camera import Camera
from tests.method import corner

COUNT = 5


def write(folder: Path, poses: Callable[[list[Camera]], list[np.ndarray]]) -> Path:
    """Write a corner of a room as Panoptic captures are, with other poses than its images were taken from."""
    views = corner.arc(COUNT)
    names = list(range(1, COUNT + 1))
    for name, image in zip(names, corner.make_images(views), strict=True):
        (folder / "ims" / str(name)).mkdir(parents=True)
        Image.fromarray(image).save(folder / "ims" / str(name) / "000000.png")
    meta = {
        "w": corner.WIDTH,
        "h": corner.HEIGHT,
        "k": [[view.K.tolist() for view in views]],
        "w2c": [[pose.tolist() for pose in poses(views)]],
        "fn": [[f"{name}/000000.png" for name in names]],
        "cam_id": [names],
    }
    (folder / "train_meta.json").write_text(json.dumps(meta))
    return folder


def right(views: list[Camera]) -> list[np.ndarray]:
    return [view.viewmat for view in views]


def elsewhere(views: list[Camera]) -> list[np.ndarray]:
    """Return poses that are unrelated to the images."""
    rng = np.random.default_rng(0)
    turns = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in views]
    made = []
    for turn in turns:
        pose = np.eye(4)
        pose[:3, :3] = turn * np.sign(np.linalg.det(turn))
        pose[:3, 3] = rng.uniform(-1, 1, 3)
        made.append(pose)
    return made


def check(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = main(["capture", "check", str(folder), "--hold-out", "none", "--quick"])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_right_poses_can_be_reconstructed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = check(write(tmp_path, right), capsys)
    assert code == 0
    assert "It can be reconstructed, but no trial of novel views was made. Run\n  splatreel reconstruct" in out


def test_unconfirmed_poses_fail_the_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, error = check(write(tmp_path, elsewhere), capsys)
    assert code == 1
    assert "It can be reconstructed" not in out
    assert "Do not reconstruct it as it is" in error
