"""Requirements of a capture, the same for `capture check` and for reconstruction."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from splatreel.base import process
from splatreel.base.errors import MissingDependencyError, ReconstructionError
from splatreel.base.paged_arrays import SMALLEST
from splatreel.config import Config, LayeringConfig, preset
from splatreel.config.settings import changed
from splatreel.method.layering.sam2 import SAM2
from splatreel.run import requirements
from splatreel.run.pipeline import reconstruct
from splatreel.run.requirements import (
    check_capture,
    check_images,
    check_memory,
    check_networks,
    fitting_width,
    needed_memory,
)
from tests.method.captures import WallCapture
from tests.method.scenes import ring
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


MEASURED = {
    # width, height, training cameras, frames, bytes
    "basketball 160x90": (160, 90, 27, 10, 0.647e9),
    "built-in 256x192": (256, 192, 12, 60, 1.003e9),
    "basketball 320x180": (320, 180, 27, 60, 1.078e9),
    "yard 400x225": (400, 225, 10, 40, 0.879e9),
    "studio 320x180": (320, 180, 17, 45, 0.991e9),
    "kitchen 336x252": (336, 252, 17, 45, 1.007e9),
    "juggle 320x180": (320, 180, 26, 60, 1.174e9),
    "basketball 640x360": (640, 360, 27, 60, 2.432e9),
    "basketball 640x360, long": (640, 360, 27, 600, 2.57e9),
    "flame_steak 672x504": (672, 504, 20, 1, 0.78e9),
    "flame_steak 1345x1008": (1345, 1008, 20, 1, 1.8e9),
    "kitchen 1352x1014": (1352, 1014, 17, 10, 3.4e9),
    "kitchen 1352x1014, rich": (1352, 1014, 17, 60, 6.97e9),
    "kitchen 2576x1932": (2576, 1932, 8, 6, 4.2e9),
}
"""Peaks of `benchmarks/results.jsonl` and of its history, or measured when this was written."""


def filmed(width: int, height: int, cameras: int, frames: int) -> Any:
    """Return a stand-in of a capture."""
    return SimpleNamespace(
        path="film",
        width=width,
        height=height,
        training_cameras=[None] * cameras,
        frames=frames,
        growing=False,
        backgrounds={},
    )


@pytest.fixture(autouse=True)
def frames_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requirements, "stores_in_file", lambda size: False)


@pytest.mark.parametrize("name", MEASURED)
def test_needed_memory_matches_measured_peaks(name: str) -> None:
    *capture, peak = MEASURED[name]
    assert 0.7 <= needed_memory(filmed(*capture), Config()) / peak <= 1.3


def test_frames_in_files_halve_the_memory_of_large_captures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measured: 1.28 GB of memory, and 1.9 GB of mapped files in the cache."""
    large, small = filmed(1280, 720, 20, 60), filmed(160, 90, 27, 10)
    held = [needed_memory(capture, Config()) for capture in (large, small)]
    monkeypatch.setattr(requirements, "stores_in_file", lambda size: size >= SMALLEST)
    in_files = [needed_memory(capture, Config()) for capture in (large, small)]
    assert 1.28e9 < in_files[0] < 0.5 * held[0]
    assert in_files[1] == held[1]


def test_memory_grows_with_images_and_points_not_with_length() -> None:
    usual, config = needed_memory(filmed(640, 360, 10, 100), Config()), Config()
    assert needed_memory(filmed(1280, 720, 10, 100), config) > 2 * usual
    assert needed_memory(filmed(640, 360, 20, 100), config) > usual
    assert needed_memory(filmed(640, 360, 10, 30), config) < usual
    assert needed_memory(filmed(640, 360, 10, 3000), config) == usual
    assert needed_memory(filmed(640, 360, 10, 100), preset("paper")) > usual


def test_subject_of_few_cameras_has_its_images_twice() -> None:
    scene: Any = filmed(1280, 720, 2, 100)
    config = Config()
    scene.training_cameras = ring(2, width=1280, height=720)  # 60 degrees apart
    subject: Any = SimpleNamespace(**vars(scene) | {"backgrounds": {"cam0": (0, 0, 0)}})
    group = 3 * 1280 * 720 * 2 * (config.group.length + config.group.overlap)
    more = needed_memory(subject, config) - needed_memory(scene, config)
    assert 1.2 * group < more < 2 * group
    dense = filmed(1280, 720, 20, 100)
    dense.training_cameras = ring(20, width=1280, height=720)
    expected = needed_memory(dense, config)
    dense.backgrounds = {"cam0": (0, 0, 0)}
    assert needed_memory(dense, config) == expected, "images of dense cameras have one background"


def test_refusal_names_a_width_that_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    capture, config = filmed(2560, 1920, 40, 300), Config()
    for room in (2**33, 2**35):
        monkeypatch.setattr(requirements, "total_memory", lambda room=room: room)
        with pytest.raises(ReconstructionError, match=r"film: images of 2560x1920 by 40 .* --width \d+ fits") as raised:
            check_memory(capture, config)
        width = int(str(raised.value).split("--width ")[1].split()[0])
        fits = filmed(width, round(1920 * width / 2560), 40, 300)
        check_memory(fits, config)
        assert needed_memory(fits, config) > 0.6 * room  # the largest
    monkeypatch.setattr(requirements, "total_memory", lambda: 2**20)
    with pytest.raises(ReconstructionError, match="Use a machine with more memory"):
        check_memory(capture, config)
    monkeypatch.setattr(requirements, "total_memory", lambda: None)
    check_memory(capture, config)


def test_recommended_width_is_at_most_the_images_width() -> None:
    assert fitting_width(filmed(640, 360, 10, 100), Config(), 1e12) == 624


def test_limit_of_a_container_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    monkeypatch.setattr(process, "MOUNTED", tmp_path)
    monkeypatch.setattr(process, "OWN", tmp_path / "own")
    (tmp_path / "own").write_text("0::/\n")
    monkeypatch.setattr(requirements, "physical_memory", lambda: 8 << 30)
    assert requirements.total_memory() == 8 << 30
    (tmp_path / "memory.max").write_text("max\n")
    assert requirements.total_memory() == 8 << 30
    (tmp_path / "memory.max").write_text(f"{2 << 30}\n")
    assert requirements.total_memory() == 2 << 30
    (tmp_path / "memory.current").write_text(f"{3 << 29}\n")
    (tmp_path / "memory.stat").write_text(f"anon 5\ninactive_file {1 << 28}\n")
    assert requirements.free_memory() == 3 << 28
