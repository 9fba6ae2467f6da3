""""""

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.base import Capture
from splatreel.capture.reading import FramePrefetcher, median_images, moving_pixels
from tests.capture import folders
from tests.evaluation import scenes


class Watched(Capture):
    """Capture that counts its reads; frame 20 cannot be read."""

    def __init__(self) -> None:
        super().__init__(Path("a"), folders.cameras(), held_out=[], frame_range=(0, 30))
        self.begun: list[int] = []
        self.ahead = threading.Event()

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        self.begun.append(first)
        if len(self.begun) == 2:
            self.ahead.set()
        if first <= 20 < first + len(out):
            raise CaptureError("frame 20 is damaged")
        out[:] = np.arange(first, first + len(out)).reshape(-1, 1, 1, 1, 1)


class Slow(Capture):
    """Long capture that reads slowly."""

    def __init__(self) -> None:
        super().__init__(Path("a"), folders.cameras(), held_out=[], frame_range=(0, 3000))
        self.begun: list[int] = []
        self.ahead = threading.Event()

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        time.sleep(0.01)
        self.begun.append(len(out))
        if len(self.begun) == 3:
            self.ahead.set()
        out[:] = (np.arange(first, first + len(out)) % 256).reshape(-1, 1, 1, 1, 1)


def test_stretches_keep_order_and_overlap() -> None:
    with FramePrefetcher(Watched(), ["cam01"], [(0, 6), (5, 6), (10, 4)]) as frames:
        firsts = [(len(part), int(part[0, 0, 0, 0, 0])) for part in frames]
    assert firsts == [(6, 0), (6, 5), (4, 10)]


def test_exactly_one_stretch_is_decoded_ahead() -> None:
    source = Watched()
    with FramePrefetcher(source, ["cam01"], [(0, 2), (2, 2), (4, 2)]) as frames:
        next(iter(frames))
        assert source.ahead.wait(120)
    assert source.begun == [0, 2]


def test_ahead_false_decodes_on_request() -> None:
    source = Watched()
    with FramePrefetcher(source, ["cam01"], iter([(0, 2), (2, 2), (4, 2)]), ahead=False) as frames:
        parts = iter(frames)
        next(parts)
        assert not source.ahead.wait(0.1)
        next(parts)
        assert source.begun == [0, 2]


def test_shared_frames_are_decoded_once_and_copied() -> None:
    source, seen = Watched(), []
    with FramePrefetcher(source, ["cam01"], [(0, 6), (5, 6), (9, 4), (15, 3)], shared=2) as frames:
        for part in frames:
            seen.append(part[:, 0, 0, 0, 0].tolist())
            part[:] = 0
    assert seen == [list(range(6)), list(range(5, 11)), list(range(9, 13)), list(range(15, 18))]
    assert source.begun == [0, 4, 6, 10, 11, 15]


def test_error_is_raised_at_its_stretch() -> None:
    with FramePrefetcher(Watched(), ["cam01"], [(0, 5), (18, 5)]) as frames:
        parts = iter(frames)
        assert len(next(parts)) == 5
        with pytest.raises(CaptureError, match="frame 20"):
            next(parts)


def test_no_stretches_give_nothing() -> None:
    with FramePrefetcher(Watched(), ["cam01"], []) as frames:
        assert list(frames) == []


def test_leaving_does_not_wait_for_a_stretch() -> None:
    source = Slow()
    with FramePrefetcher(source, ["cam01"], [(0, 2), (2, 2000)]) as frames:
        next(iter(frames))
        assert source.ahead.wait(120)
    assert sum(source.begun) < 100


def test_stretch_is_complete_for_any_chunk_size() -> None:
    with FramePrefetcher(Slow(), ["cam01", "cam02"], [(3, 11)]) as frames:
        (part,) = list(frames)
    assert part[:, 1, 0, 0, 0].tolist() == list(range(3, 14))


FRAMES = 45
SIDE = 4


class SquareCapture(Capture):
    """Capture of a bright 4-pixel square that moves right by one pixel per frame, over a background that identifies the camera."""

    def __init__(self, frames: int = FRAMES) -> None:
        self.asked: list[int] = []
        super().__init__(Path("square"), scenes.cameras(), held_out=["cam00"], frame_range=(0, frames))

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        self.asked += range(first, first + len(out))
        for t in range(len(out)):
            for c, name in enumerate(cameras):
                out[t, c] = 10 * int(name[3:])
                out[t, c, :SIDE, first + t : first + t + SIDE] = 200


def test_median_image_shows_static_content() -> None:
    capture = SquareCapture()
    for image, value in zip(median_images(capture, ["cam01", "cam03"]), (10, 30), strict=True):
        assert image.dtype == np.uint8
        assert np.all(image == value)
    assert len(capture.asked) == 2 * 20
    assert (min(capture.asked), max(capture.asked)) == (0, FRAMES - 1)


def test_moving_pixels_cover_the_moving_square() -> None:
    capture = SquareCapture()
    median = median_images(capture, ["cam02"])[0]
    expected = np.zeros((scenes.HEIGHT, scenes.WIDTH), bool)
    expected[:SIDE, 30 : 30 + SIDE] = True
    truth = capture.read(30, 1, ["cam02"])[0, 0].astype(np.float32) / 255
    np.testing.assert_array_equal(moving_pixels(truth, median), expected)


def test_moving_pixels_ignore_small_differences() -> None:
    median = np.full((2, 3, 3), 100, np.uint8)
    truth = np.full((2, 3, 3), 100 / 255, np.float32)
    truth[0, 1] += 7 / 255
    truth[1, 2, 0] -= 30 / 255  # one channel: 10 in the mean
    assert np.argwhere(moving_pixels(truth, median)).tolist() == [[1, 2]]


def test_moving_pixels_are_empty_for_one_frame() -> None:
    capture = SquareCapture(1)
    truth = capture.read(0, 1, ["cam00"])[0, 0].astype(np.float32) / 255
    assert not moving_pixels(truth, median_images(capture, ["cam00"])[0]).any()
