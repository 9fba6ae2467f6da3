"""Captures of images in memory."""

from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.array_capture import capture_from_arrays
from splatreel.scene.camera import Camera
from tests.method.scenes import ring

T, WIDTH, HEIGHT = 3, 8, 6
CAMERAS: list[Camera] = ring(4, width=WIDTH, height=HEIGHT)


def images(kind: Any = np.uint8) -> np.ndarray:
    values = np.random.default_rng(0).integers(0, 256, (T, len(CAMERAS), HEIGHT, WIDTH, 3))
    return values.astype(np.uint8) if kind is np.uint8 else (values / 255).astype(kind)


@pytest.mark.parametrize("kind", [np.uint8, np.float32, np.float64])
def test_images_are_read_as_given(kind: Any) -> None:
    names = [camera.name for camera in CAMERAS]
    capture = capture_from_arrays(images(kind), CAMERAS, [1.0, 1.04, 1.08], held_out=names[:1])
    assert (capture.frames, capture.width, capture.height, capture.held_out) == (T, WIDTH, HEIGHT, names[:1])
    assert capture.fps == pytest.approx(25)
    np.testing.assert_array_equal(capture.read(1, 2, [names[2], names[0]]), images()[1:, [2, 0]])


def test_fingerprint_follows_the_images() -> None:
    other = images()
    other[2, 3, 5, 7, 1] ^= 1
    prints = [capture_from_arrays(each, CAMERAS).fingerprint() for each in (images(), images(), other)]
    assert prints[0] == prints[1] != prints[2]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"images": images()[0]}, r"shape \(4, 6, 8, 3\), expected \[T, 4, H, W, 3\]"),
        ({"images": [images()[0], images()[0, :3]]}, "are not an array"),
        ({"images": images()[:, :3]}, "expected .* for 4 cameras"),
        ({"images": images(np.float32) * 255}, "frame 0 has values from .* Give uint8, or floats 0..1"),
        ({"images": images(np.float32) * np.nan}, "frame 0 has values from nan"),
        ({"images": images().astype(np.int64)}, "are of type int64"),
        ({"cameras": ring(4, width=16, height=12)}, r"are 8x6, and camera .* is 16x12.*camera\.resized\(8, 6\)"),
        ({"times": [0.0, 0.04]}, r"times have shape \(2,\), expected one finite number for each of 3"),
        ({"times": [0.0, 0.04, 0.2]}, r"Frame 1 is at 0\.04 s.*0\.1 s"),
        ({"times": [0.2, 0.1, 0.0]}, "evenly spaced"),
        ({"held_out": ["nobody"]}, "no camera 'nobody' to hold out"),
    ],
)
def test_bad_arrays_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(CaptureError, match=message):
        capture_from_arrays(**({"images": images(), "cameras": CAMERAS} | changes))
