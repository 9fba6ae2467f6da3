"""Frames in files equal frames in memory and do not use it."""

import os
from pathlib import Path

import numpy as np
import pytest

from splatreel.base import paged_arrays as frame_file
from splatreel.base.paged_arrays import frame_array, is_in_file, release_pages
from splatreel.capture.reading import FramePrefetcher
from splatreel.run.pipeline import reconstruct
from tests.method.captures import WallCapture
from tests.method.small import small
from tests.run.test_pipeline import content

pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="looks at /proc")


@pytest.fixture(autouse=True)
def on_a_disk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Store arrays of any size in files of this folder."""
    monkeypatch.setattr(frame_file, "_lies_in_memory", lambda _: False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


def resident() -> int:
    """Return the bytes of files and shared memory that this process has mapped."""
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines() if ":" in line)
    return 1024 * sum(int(lines[name].split()[0]) for name in ("RssFile", "RssShmem"))


def test_large_arrays_are_in_unnamed_files(tmp_path: Path) -> None:
    large = frame_array((3, 64, 64, 3), smallest=1000)
    assert is_in_file(large)
    assert is_in_file(large[1:, 5])
    assert large.flags.writeable
    assert list(tmp_path.iterdir()) == []
    assert not is_in_file(frame_array((3, 2)))
    assert not is_in_file(np.zeros(3, np.uint8))


def test_released_pages_keep_their_content() -> None:
    array = frame_array((64 << 20,), smallest=0)
    before = resident()
    array[:] = np.resize(np.arange(251, dtype=np.uint8), len(array))
    assert resident() > before + (60 << 20)
    release_pages(array[7:])
    assert resident() < before + (8 << 20)
    assert np.array_equal(array[: 2 * 251], np.tile(np.arange(251, dtype=np.uint8), 2))
    array[5] = 99
    release_pages(array)
    assert array[5] == 99
    release_pages(np.zeros(4, np.uint8))  # nothing to do


def test_full_or_memory_folder_uses_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", full)
        assert not is_in_file(frame_array((1000,), smallest=0))
    monkeypatch.setattr(frame_file, "_lies_in_memory", lambda _: True)
    assert not is_in_file(frame_array((1000,), smallest=0))


def test_prefetched_stretch_is_in_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_array, "__defaults__", (0,))
    capture = WallCapture(9)
    names = [camera.name for camera in capture.cameras]
    with FramePrefetcher(capture, names, [(0, 5), (4, 5)], shared=1) as stretches:
        found = list(stretches)
    assert all(is_in_file(frames) for frames in found)
    for first, frames in zip((0, 4), found, strict=True):
        assert np.array_equal(frames, capture.read(first, 5, names))


def test_reel_bytes_do_not_depend_on_frame_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = small({"training_megapixels": 0.0005})  # also at half size
    capture = WallCapture(5, drift=0.1)
    reconstruct(capture, tmp_path / "memory", config, device="cpu")
    made: list[bool] = []
    monkeypatch.setattr(frame_array, "__defaults__", (0,))
    mapped = frame_file._mapped
    monkeypatch.setattr(frame_file, "_mapped", lambda array: made.append(mapped(array) is not None) or mapped(array))
    reconstruct(capture, tmp_path / "files", config, device="cpu")
    assert any(made)
    assert content(tmp_path / "files" / "reel") == content(tmp_path / "memory" / "reel")
