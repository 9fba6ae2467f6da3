"""Orientations, compared with Pillow's and by hand."""

import struct

import numpy as np
import pytest
from PIL import Image, ImageOps

from splatreel.capture.orientation import ALL, EXIF, STORED, Orientation, display_orientation

IMAGE = np.arange(24, dtype=np.uint8).reshape(4, 6)


def matrix(a: int, b: int, c: int, d: int) -> bytes:
    return struct.pack("=9i", a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30)


@pytest.mark.parametrize("number", range(1, 9))
def test_exif_orientations_are_those_of_pillow(number: int) -> None:
    image = Image.fromarray(IMAGE)
    image.getexif()[0x112] = number
    np.testing.assert_array_equal(EXIF[number].apply(IMAGE), np.asarray(ImageOps.exif_transpose(image)))
    assert EXIF[number].size(6, 4) == EXIF[number].apply(IMAGE).shape[::-1]


@pytest.mark.parametrize("orientation", ALL)
def test_display_matrix_maps_pixels_to_where_they_are_shown(orientation: Orientation) -> None:
    """The matrix [[a, b], [c, d]] moves a pixel at (x, y) from the center to (a x + c y, b x + d y)."""
    shown = orientation.apply(IMAGE)
    for a, b, c, d in ((s, 0, 0, t) if k else (0, s, t, 0) for k in (0, 1) for s in (-1, 1) for t in (-1, 1)):
        if display_orientation(matrix(a, b, c, d)) == orientation:
            break
    else:
        pytest.fail("no display matrix has this orientation")
    height, width = IMAGE.shape
    for y, x in np.ndindex(IMAGE.shape):
        across, down = 2 * x - width + 1, 2 * y - height + 1
        column, row = (
            (a * across + c * down + shown.shape[1] - 1) // 2,
            (b * across + d * down + shown.shape[0] - 1) // 2,
        )
        assert shown[row, column] == IMAGE[y, x]


def test_identity_and_angles_between_quarter_turns() -> None:
    assert display_orientation(matrix(1, 0, 0, 1)) == STORED
    assert display_orientation(matrix(3, 0, 0, 2)) == STORED  # pixels that are not square
    assert display_orientation(matrix(1, 1, -1, 1)) is None
    assert display_orientation(matrix(0, 0, 0, 0)) is None
