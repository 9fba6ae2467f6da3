""""""

from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.color import (
    BT2020,
    FULL,
    HLG,
    P3,
    PQ,
    SrgbConversion,
    VideoColor,
    hlg_light,
    over_black,
    pq_light,
)
from splatreel.capture.video import VideoFile
from tests.capture.colors import COLORS, SIDE, squares, write_colors


def converted(primaries: int, transfer: int, signal: tuple[float, ...]) -> list[int]:
    code = np.rint(FULL * np.array([[signal]])).astype(np.uint16)
    return SrgbConversion(primaries, transfer)(code)[0, 0].tolist()


def test_transfer_functions_of_bt2100() -> None:
    """Report BT.2408 has 75 % HLG and 58 % PQ for white, 38 % of both for an 18 % gray card: 26 cd/m2."""
    np.testing.assert_allclose(hlg_light(np.array([0.0, 0.75, 1.0])), [0, 1, 3.774], atol=1e-3)
    np.testing.assert_allclose(203 * pq_light(np.array([0.0, 0.5807, 0.38, 1.0])), [0, 203, 26, 10000], rtol=0.02)


@pytest.mark.parametrize(("transfer", "white"), [(HLG, 0.75), (PQ, 0.5807)])
def test_white_becomes_white_and_brighter_light_is_clipped(transfer: int, white: float) -> None:
    assert converted(BT2020, transfer, (white,) * 3) == [255] * 3
    assert converted(BT2020, transfer, (0.9,) * 3) == [255] * 3
    assert converted(BT2020, transfer, (0,) * 3) == [0] * 3


@pytest.mark.parametrize("primaries", [BT2020, P3, 0])
def test_grays_of_other_gamuts_stay(primaries: int) -> None:
    grays = np.arange(256)[:, None, None].repeat(3, 2)
    found = SrgbConversion(primaries, 0)((grays * 256).astype(np.uint16))
    assert np.abs(found - grays).max() <= 1


@pytest.mark.parametrize(
    ("signal", "color"), [((234, 51, 35), (255, 0, 0)), ((117, 251, 76), (0, 255, 0)), ((0, 0, 245), (0, 0, 255))]
)
def test_primaries_of_srgb_in_display_p3(signal: tuple[int, ...], color: tuple[int, ...]) -> None:
    """The primaries of sRGB in Display P3, as browsers show them."""
    assert np.abs(np.array(converted(P3, 0, tuple(value / 255 for value in signal))) - color).max() <= 8  # steep near 0
    assert converted(P3, 0, (1, 0, 0)) == [255, 0, 0]


def test_straight_alpha_is_composed_over_black() -> None:
    image = np.array([[[200, 100, 50, 255], [200, 100, 50, 51], [200, 100, 50, 0]]], np.uint8)
    assert over_black(image)[0].tolist() == [[200, 100, 50], [40, 20, 10], [0, 0, 0]]
    wide = image.astype(np.uint16) * 257
    assert over_black(wide)[0].tolist() == [[51400, 25700, 12850], [10280, 5140, 2570], [0, 0, 0]]


TO_BT2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
"""Linear light from BT.709 to BT.2020. Source: ITU-R BT.2087."""


def read(path: Path, transfer: str | None = None) -> np.ndarray:
    video = VideoFile(path, transfer=transfer)
    out = np.empty((1, video.height, video.width, 3), np.uint8)
    video.read_into(out, np.array([0]))
    return squares(out[0])


def wide_light() -> np.ndarray:
    """Return the linear light of COLORS in BT.2020."""
    signal = COLORS / 255
    return np.where(signal <= 0.04045, signal / 12.92, ((signal + 0.055) / 1.055) ** 2.4) @ TO_BT2020.T


def hlg(light: np.ndarray) -> np.ndarray:
    """Return the HLG signal of light relative to white, which is 75 %. Source: ITU-R BT.2100, table 5, and BT.2408."""
    light = light * (np.exp((0.75 - 0.55991073) / 0.17883277) + 0.28466892) / 12
    upper = 0.17883277 * np.log(np.maximum(12 * light - 0.28466892, 1e-9)) + 0.55991073
    return np.where(light <= 1 / 12, np.sqrt(3 * light), upper)


def pq(luminance: np.ndarray) -> np.ndarray:
    """Return the PQ signal of a luminance in cd/m2. Source: ITU-R BT.2100, table 4."""
    y = (luminance / 10000) ** (2610 / 16384)
    return ((0.8359375 + 18.8515625 * y) / (1 + 18.6875 * y)) ** 78.84375


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("matrix", [1, 2, 5, 6, 7])
def test_matrix_and_range_are_those_that_the_video_declares(tmp_path: Path, matrix: int, full: bool, bits: int) -> None:
    """An undeclared matrix is BT.601, as in FFmpeg and OpenCV."""
    path = write_colors(tmp_path / "a.mp4", COLORS / 255, (matrix, 2, 1), full=full, bits=bits)
    assert np.abs(read(path) - COLORS).max() <= 2


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("bits", [8, 10])
def test_bt2020_is_converted(tmp_path: Path, bits: int, full: bool) -> None:
    light = wide_light()
    signal = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    path = write_colors(tmp_path / "a.mp4", signal, (BT2020, BT2020, 14), bits=bits, full=full)
    off = np.abs(read(path) - COLORS)
    assert off[3:].max() <= (2 if bits == 10 else 6)
    assert off.max() <= (4 if bits == 10 else 13)  # dark channels beside bright ones, which hold few steps of the input


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "mov"])
@pytest.mark.parametrize("transfer", [HLG, PQ])
def test_hdr_is_converted(tmp_path: Path, transfer: int, suffix: str) -> None:
    """Report BT.2408 puts the white of graphics at 75 % of HLG, and at 203 cd/m2 in PQ."""
    light = wide_light()
    signal = pq(203 * light) if transfer == PQ else hlg(light)
    path = write_colors(tmp_path / f"a.{suffix}", signal, (BT2020, BT2020, transfer), bits=10)
    off = np.abs(read(path) - COLORS)
    assert off[3:].max() <= 2
    assert off.max() <= 13  # dark channels, as above
    said = VideoFile(path).color.conversions(SIDE)
    assert len(said) == 1
    assert ("PQ" if transfer == PQ else "HLG") in said[0]


def test_undeclared_transfer_of_bt2020_is_asked_for(tmp_path: Path) -> None:
    signal = hlg(wide_light())
    path = write_colors(tmp_path / "cam03.mov", signal, (BT2020, 2, 2), bits=10)
    with pytest.raises(CaptureError, match=r"cam03\.mov: declares BT\.2020 colors but no transfer function"):
        VideoFile(path)
    assert np.abs(read(path, "hlg") - COLORS)[3:].max() <= 2
    declared = write_colors(tmp_path / "b.mov", COLORS / 255, (1, 2, 1))
    np.testing.assert_array_equal(read(declared, "hlg"), read(declared))  # what the video declares counts


def test_display_p3_video_is_converted(tmp_path: Path) -> None:
    signal = np.array([(234, 51, 35), (117, 251, 76), (128, 128, 128)]) / 255
    path = write_colors(tmp_path / "a.mp4", signal, (1, P3, 1), bits=10)
    assert np.abs(read(path) - [(255, 0, 0), (0, 255, 0), (128, 128, 128)]).max() <= 8


@pytest.mark.parametrize(
    "declared", [{"matrix": 8}, {"matrix": 14}, {"transfer": 8}, {"transfer": 10}, {"primaries": 10}]
)
def test_colors_that_cannot_be_converted_are_named(declared: dict[str, int]) -> None:
    with pytest.raises(CaptureError, match=r"cam00\.mp4: its .* \(number \d+ of ITU-T H\.273\) cannot be converted"):
        replace(VideoColor("yuv420p"), **declared).interpreted(Path("cam00.mp4"), None)


def test_guesses_are_said() -> None:
    assert VideoColor("yuv420p").conversions(576) == []
    assert "BT.601 is assumed" in VideoColor("yuv420p").conversions(1080)[0]
    assert VideoColor("yuv420p", 1).conversions(1080) == []
    assert VideoColor("gbrp").conversions(1080) == VideoColor("gray").conversions(1080) == []
    assert "10 bits without a declared transfer function" in VideoColor("yuv420p10le", 1).conversions(1080)[0]
    assert VideoColor("yuva444p", 1).conversions(1080) == ["transparent pixels are composed over black"]


@pytest.mark.parametrize("interlaced", [True, False])
def test_interlaced_video_is_named(tmp_path: Path, interlaced: bool) -> None:
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"x264-params": f"interlaced={int(interlaced)}"})
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        container.mux(stream.encode(av.VideoFrame(64, 64, "yuv420p")))
        container.mux(stream.encode(None))
    said = VideoFile(path).color.conversions(64)
    assert any("interlaced" in phrase for phrase in said) == interlaced
