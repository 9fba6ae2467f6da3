"""Conversion to sRGB, at values from the standards."""

import numpy as np
import pytest

from splatreel.capture.srgb import BT2020, FULL, HLG, P3, PQ, SrgbConversion, hlg_light, over_black, pq_light


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
