import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatreel.base.errors import CaptureError
from splatreel.capture.base import WIDEST, Capture, Request
from splatreel.scene.camera import Camera
from tests.capture import folders


class Numbers(Capture):
    """Capture in which every pixel of a frame is its number in the files."""

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        out[:] = np.arange(first, first + len(out)).reshape(-1, 1, 1, 1, 1)


def capture(cameras: list[Camera] | None = None, name: str = "a", **options) -> Numbers:
    options.setdefault("held_out", ["cam00"])
    return Numbers(Path(name), folders.cameras() if cameras is None else cameras, **options)


def test_read_counts_within_the_frame_range() -> None:
    source = capture(frame_range=(5, 9))
    assert source.frames == 4
    assert source.read(1, 3, ["cam01"])[:, 0, 0, 0, 0].tolist() == [6, 7, 8]


@pytest.mark.parametrize(("first", "count"), [(-1, 1), (0, 0), (0, 5), (4, 1)])
def test_frames_outside_the_range_are_refused(first: int, count: int) -> None:
    with pytest.raises(CaptureError, match="there are 0:4"):
        capture(frame_range=(5, 9)).read(first, count, ["cam01"])


def test_unknown_cameras_are_refused() -> None:
    with pytest.raises(CaptureError, match=r"no camera 'cam77'.* cam00, cam01"):
        capture().read(0, 1, ["cam77"])
    with pytest.raises(CaptureError, match="no camera 'cam77' to hold out"):
        capture(held_out=["cam77"])


def test_holding_out_all_cameras_is_refused() -> None:
    with pytest.raises(CaptureError, match="all 4 cameras are held out"):
        capture(held_out=[c.name for c in folders.cameras()])


def test_duplicate_names_and_sizes_are_refused() -> None:
    cameras = folders.cameras()
    with pytest.raises(CaptureError, match="same name"):
        capture([*cameras, cameras[1]])
    with pytest.raises(CaptureError, match=r"different sizes .*16x12"):
        capture([*cameras, replace(cameras[1].resized(16, 12), name="small")])


def test_fingerprint_changes_with_content() -> None:
    changed = folders.cameras()
    changed[2] = replace(changed[2], viewmat=changed[2].viewmat + 1e-3 * (np.arange(4) < 3)[:, None])
    prints = [
        capture(frame_range=(0, 9)),
        capture(frame_range=(1, 9)),
        capture(frame_range=(0, 8)),
        capture(frame_range=(0, 9), held_out=["cam01"]),
        capture(frame_range=(0, 9), name="b"),
        capture(changed, frame_range=(0, 9)),
        capture([c.resized(16, 12) for c in folders.cameras()], frame_range=(0, 9)),
    ]
    assert len({p.fingerprint() for p in prints}) == len(prints)
    assert capture(frame_range=(0, 9)).fingerprint() == prints[0].fingerprint()


@given(st.integers(1, 4000), st.integers(1, 4000), st.integers(1, 4000))
def test_width_keeps_the_aspect_ratio(width: int, height: int, wanted: int) -> None:
    request = Request(width=wanted)
    if round(height * wanted / width) < 1:
        with pytest.raises(CaptureError, match="larger size"):
            request.size(width, height, Path("a"))
        return
    if round(height * wanted / width) > WIDEST:
        with pytest.raises(CaptureError, match="ask for less"):
            request.size(width, height, Path("a"))
        return
    out = request.size(width, height, Path("a"))
    assert out[0] == wanted
    assert abs(out[1] - height * wanted / width) <= 0.5 + 1e-6


@pytest.mark.parametrize("scale", [0, -1, math.nan, math.inf])
def test_invalid_capture_sizes_are_refused(scale: float) -> None:
    with pytest.raises(CaptureError, match="positive"):
        Request(scale=scale).size(64, 48, Path("a"))


def test_width_and_scale_exclude_each_other() -> None:
    with pytest.raises(CaptureError, match="both width 8 and scale"):
        Request(width=8, scale=0.5).size(64, 48, Path("a"))


@pytest.mark.parametrize("frames", [(-1, 3), (2, 2), (3, 1), (0, 11), (10, 12)])
def test_invalid_frame_ranges_are_refused(frames: tuple[int, int]) -> None:
    with pytest.raises(CaptureError, match="the capture has frames 0:10"):
        Request(frames=frames).range(10, Path("a"))
