"""`splatreel capture check` on correct poses and on poses that the images do not confirm."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.cli.main import main
from splatreel.scene.camera import Camera
from tests.method import corner
from tests.segmentation import scenes

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


def test_far_cameras_get_the_commands_that_confirm_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Six cameras, 60 degrees apart, before backgrounds that have nothing in common."""
    scene, masks = scenes.write_capture(tmp_path / "my scene", 3), tmp_path / "masks"
    code, out, _ = check(scene, capsys)
    assert code == 0
    assert "the poses cannot be confirmed by images this far apart" in out
    assert f'splatreel capture masks "{scene}" --out masks\n' in out
    assert f'splatreel capture check "{scene}" --hold-out none --masks masks\n' in out
    _, shown = scenes.film(3)
    write_masks(masks, shown)
    right = ["capture", "check", str(scene), "--hold-out", "none", "--quick", "--masks", str(masks)]
    assert main(right) == 0
    out = capsys.readouterr().out
    assert "the poses are confirmed by the masks" in out
    assert "It can be reconstructed" in out
    write_masks(masks, np.roll(shown, scenes.WIDTH // 5, -1))
    assert main(right) == 1
    assert "masks contradict each other" in capsys.readouterr().err
    shutil.rmtree(masks / "2")
    write_masks(masks, shown[:, [0, 2, 3, 4, 5]], ["1", "3", "4", "5", "6"])
    assert main([*right[:3], "--hold-out", "2", *right[5:]]) == 0
    assert "there are no masks of 2, which training does not need" in capsys.readouterr().out


def write_masks(folder: Path, shown: np.ndarray, names: list[str] | None = None) -> None:
    """Write masks [T, C, H, W] bool."""
    for name, frames in zip(names or [str(c + 1) for c in range(shown.shape[1])], shown.swapaxes(0, 1), strict=True):
        (folder / name).mkdir(parents=True, exist_ok=True)
        for number, mask in enumerate(frames):
            Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(folder / name / f"{number:06d}.png")
