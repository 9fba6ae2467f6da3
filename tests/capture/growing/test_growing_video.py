from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.growing.growing_video import GrowingVideo
from splatreel.capture.growing.growth import Growth
from splatreel.capture.srgb import BT2020, HLG
from splatreel.capture.video import VideoFile
from tests.capture.colors import COLORS, SIDE, write_colors, write_display_matrix
from tests.capture.growing.recorder import CONTAINERS


@pytest.mark.parametrize("suffix", CONTAINERS)
def test_color_and_orientation_are_those_of_the_complete_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    write_colors(
        path, COLORS / 255, (BT2020, BT2020, HLG), bits=10, frames=3, lines=2 * SIDE, options=CONTAINERS[suffix][1]
    )
    if suffix == "mp4":
        write_display_matrix(path, (0, 1, 1, 0))
    growing, complete = GrowingVideo(path, Growth.over(tmp_path)), VideoFile(path)
    try:
        shape = (1, complete.height, complete.width, 3)
        assert (growing.height, growing.width) == shape[1:3]
        assert growing.color == complete.color
        found, expected = np.empty(shape, np.uint8), np.empty(shape, np.uint8)
        growing.read_into(found, np.array([1]))
        complete.read_into(expected, np.array([1]))
        np.testing.assert_array_equal(found, expected)
    finally:
        growing.close()


def test_ambiguous_color_is_refused_on_opening(tmp_path: Path) -> None:
    path = write_colors(tmp_path / "a.mkv", COLORS / 255, (BT2020, 2, 2), bits=10)
    with pytest.raises(CaptureError, match=r"a\.mkv: declares BT\.2020 colors but no transfer function"):
        GrowingVideo(path, Growth.over(tmp_path))
    growing = GrowingVideo(path, Growth.over(tmp_path), "hlg")
    assert growing.color.transfer == HLG
    growing.close()
