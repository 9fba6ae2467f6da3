"""Requirements of a capture, the same for `capture check` and for reconstruction."""

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from splatreel.base.errors import MissingDependencyError, ReconstructionError
from splatreel.config import LayeringConfig
from splatreel.config.settings import changed
from splatreel.method.layering.sam2 import SAM2
from splatreel.run.pipeline import reconstruct
from splatreel.run.requirements import check_capture, check_images, check_networks
from tests.method.captures import WallCapture
from tests.run.test_pipeline import CONFIG

NAMES = ["a", "b", "c"]


def moments(level: int, spread: int = 3) -> np.ndarray:
    """Return images of three cameras, the last of which shows only noise around a gray level."""
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (2, 3, 8, 8, 3))
    frames[:, 2] = rng.integers(level - spread, level + spread + 1, frames[:, 2].shape).clip(0, 255)
    return frames.astype(np.uint8)


@pytest.mark.parametrize(("level", "color"), [(2, "black"), (16, "black"), (253, "white"), (235, "white")])
def test_cameras_that_show_nothing_are_named(level: int, color: str) -> None:
    capture = WallCapture(2)
    with pytest.raises(ReconstructionError, match=f"wall: all images of camera c are {color}. Choose other frames"):
        check_images(capture, NAMES, moments(level))
    with pytest.raises(ReconstructionError, match="all images of every camera"):
        check_images(capture, ["c"], moments(level)[:, 2:])


@pytest.mark.parametrize("level", [30, 128, 225])
def test_gray_or_briefly_dark_images_are_accepted(level: int) -> None:
    capture = WallCapture(2)
    check_images(capture, NAMES, moments(level))
    frames = moments(2)
    frames[1, 2, 0, 0] = 200
    check_images(capture, NAMES, frames)


def test_black_capture_is_refused_before_it_is_trained(tmp_path: Path) -> None:
    class Black(WallCapture):
        def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
            out[:] = 0

    with pytest.raises(ReconstructionError, match="all images of every camera are black"):
        reconstruct(Black(4), tmp_path / "run", CONFIG, device="cpu")
    assert not list(tmp_path.rglob("*.safetensors"))


def test_three_cameras_of_which_one_is_held_out_are_too_few() -> None:
    capture = WallCapture(2, cameras=3)
    check_capture(capture)
    capture.held_out = [capture.cameras[0].name]
    with pytest.raises(ReconstructionError, match=r"only 2 cameras are left .*--hold-out none"):
        check_capture(capture)


@pytest.mark.parametrize(("setting", "name"), [("layering.flow", "raft"), ("layering.segment", "sam2")])
def test_networks_that_are_missing_are_named_before_anything_is_trained(
    setting: str, name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for module in ("torchvision.models.optical_flow", "sam2.build_sam"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependencyError, match=r'Run: pip install "splatreel\[models\]"'):
        reconstruct(WallCapture(4), tmp_path / "run", changed(CONFIG, {setting: name}), device="cpu")
    assert list(tmp_path.iterdir()) == []


def test_weights_that_are_missing_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, SAM2.module, ModuleType(SAM2.module))
    monkeypatch.setenv(SAM2.variable, str(tmp_path / "absent.pt"))
    config = LayeringConfig(segment="sam2")
    with pytest.raises(MissingDependencyError, match=r"absent\.pt does not exist\. Download https"):
        check_networks(config)
    (tmp_path / "absent.pt").touch()
    check_networks(config)
