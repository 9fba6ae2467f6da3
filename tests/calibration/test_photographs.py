"""Hostile folders of photographs for `capture calibrate --also`."""

import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.calibration.photographs import check_photos, write_photos


def png_header(width: int, height: int) -> bytes:
    """Return the start of a PNG file that claims a size."""
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))


@pytest.mark.parametrize("content", [b"", b"no image", png_header(1_000_000, 1_000_000), png_header(0, 10)])
def test_files_that_are_no_images_are_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(CaptureError, match=r"a\.png"):
        write_photos(check_photos(tmp_path), tmp_path / "pictures", Silent())


@pytest.mark.skipif(os.name != "posix", reason="pipes")
def test_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(CaptureError):
        write_photos(check_photos(tmp_path), tmp_path / "pictures", Silent())


def test_truncated_photograph_is_named(tmp_path: Path) -> None:
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)).save(tmp_path / "a.png")
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(CaptureError, match=r"a\.png"):
        write_photos(check_photos(tmp_path), tmp_path / "pictures", Silent())
