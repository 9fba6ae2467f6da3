"""Captures of images in memory."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.array_capture import capture_from_arrays
from splatreel.scene.camera import Camera
from tests.method.scenes import ring

T, WIDTH, HEIGHT = 3, 8, 6
CAMERAS: list[Camera] = ring(4, width=WIDTH, height=HEIGHT)


POINTS = np.zeros((9, 3))


def with_lens(factors: np.ndarray, center: list[float] | None = None) -> list[Camera]:
    """Return the cameras with K multiplied by a matrix [3, 3], and with another principal point."""
    matrices = [(factors @ camera.K).astype(np.float32) for camera in CAMERAS]
    for K in matrices:
        K[:2, 2] = K[:2, 2] if center is None else center
    return [replace(camera, K=K) for camera, K in zip(CAMERAS, matrices, strict=True)]


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
        ({"times": [0.2, 0.1, 0.0]}, "times must rise.*Frame 1 is at 0.1 s, not after frame 0 at 0.2 s"),
        ({"times": [0.0, 0.1, 0.1]}, "times must rise.*leave out repeated ones"),
        ({"times": [0.0, np.nan, 0.1]}, "1 are NaN or infinite"),
        ({"times": ["a", "b", "c"]}, "times are not numbers"),
        ({"times": [0, 33.3, 66.7]}, "33.35 s apart.*milliseconds.*give fps=0.02999"),
        ({"times": np.arange(3) * 33333.0}, "microseconds"),
        ({"times": np.arange(3) * 33333333.0 + 1e9}, "nanoseconds"),
        ({"fps": 0.0}, "fps is 0. Give the number of frames per second"),
        ({"fps": float("nan")}, "fps is nan"),
        ({"images": (images() > 127).astype(np.uint8)}, "nowhere above 1. Multiply floats"),
        ({"images": np.concatenate([images()] * 2, -1)[..., :4]}, "Leave out the alpha channel"),
        ({"images": np.moveaxis(images(), -1, 2)}, "Colors come last"),
        ({"images": np.swapaxes(images(), 0, 1)}, "Frames come first"),
        ({"cameras": [{"name": "a"}] * 4}, "a camera is of type dict"),
        (
            {"cameras": with_lens(np.diag([1 / WIDTH, 1 / HEIGHT, 1]))},
            "multiply its first row by 8 and its second row by 6",
        ),
        ({"cameras": with_lens(np.diag([2, 2, 1]))}, r"the center of images of 16x12.*camera.resized\(8, 6\)"),
        ({"cameras": with_lens(np.diag([0.5, 0.5, 1]))}, "the center of images of 4x3"),
        ({"cameras": with_lens(np.diag([1, 3, 1]))}, "for images of another size. Give the K of these images"),
        ({"cameras": with_lens(np.diag([0.01, 1, 1]), [WIDTH / 2, HEIGHT / 2])}, "a field of view of 17.* degrees"),
        ({"points": np.zeros((3, 10))}, r"points have shape \(3, 10\), expected \[P, 3\]. Transpose them: points.T"),
        ({"points": np.zeros((9, 4))}, r"Leave out the fourth column: points\[:, :3\]"),
        ({"points": np.full((9, 3), np.nan)}, "9 of 9 points are NaN or infinite"),
        ({"points": POINTS, "point_colors": POINTS[:4]}, "there are 9 points and 4 point_colors"),
        ({"points": POINTS, "point_colors": POINTS + 200}, "Divide colors of 0..255 by 255"),
        ({"points": POINTS, "point_colors": POINTS - 0.5}, "point_colors are -0.5 to -0.5, expected 0..1"),
        ({"point_colors": POINTS}, "there are point_colors and no points"),
        ({"held_out": ["nobody"]}, "no camera 'nobody' to hold out"),
    ],
)
def test_bad_arrays_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(CaptureError, match=message):
        capture_from_arrays(**({"images": images(), "cameras": CAMERAS} | changes))


def test_a_single_name_is_held_out_and_colors_are_clipped() -> None:
    """Rounding of float32 leaves colors a little above 1."""
    capture = capture_from_arrays(
        images(), CAMERAS, held_out=CAMERAS[0].name, points=POINTS, point_colors=POINTS + 1.0000001
    )
    assert capture.held_out == [CAMERAS[0].name]
    assert capture.point_colors is not None
    assert capture.point_colors.max() == 1
