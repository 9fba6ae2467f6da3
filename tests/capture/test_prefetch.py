import threading
import time
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.base import Capture
from splatreel.capture.prefetch import FramePrefetcher
from tests.capture import folders


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
