import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.capture.images import image_size, read_image
from splatreel.errors import CaptureError


def test_image_is_resized_by_area(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
    Image.fromarray(image).save(tmp_path / "a.png")
    mean = image.reshape(12, 2, 16, 2, 3).mean((1, 3))
    assert image_size(tmp_path / "a.png") == (32, 24)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", 32, 24), image)
    assert np.abs(read_image(tmp_path / "a.png", 16, 12) - mean).max() <= 1.5


def test_gray_and_transparent_images_become_rgb(tmp_path: Path) -> None:
    Image.new("L", (8, 8), 77).save(tmp_path / "gray.png")
    Image.new("RGBA", (8, 8), (1, 2, 3, 200)).save(tmp_path / "clear.png")
    assert read_image(tmp_path / "gray.png", 8, 8)[0, 0].tolist() == [77, 77, 77]
    assert read_image(tmp_path / "clear.png", 8, 8)[0, 0].tolist() == [1, 2, 3]


def test_file_that_is_no_image_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_text("no image")
    for read in (lambda: image_size(tmp_path / "a.png"), lambda: read_image(tmp_path / "a.png", 8, 8)):
        with pytest.raises(CaptureError, match=r"a\.png: cannot be read as an image"):
            read()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes")
def test_pipe_in_place_of_an_image_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(CaptureError, match=r"a\.png: is no file"):
        image_size(tmp_path / "a.png")
    with pytest.raises(CaptureError, match=r"a\.png: is no file"):
        read_image(tmp_path / "a.png", 4, 4)
