import numpy as np

from splatreel.scene.gaussians import Gaussians
from splatreel.sequence.identity import Identities, same_rows
from tests.sequence.films import BALL, WALL, frame, scene


def test_points_in_the_same_rows_keep_their_numbers() -> None:
    identities = Identities()
    numbers = [identities.of(frame(number)) for number in (0, 1, 30)]
    for some in numbers:
        assert some.tolist() == list(range(WALL + BALL))
    assert identities.count == WALL + BALL


def test_shuffled_points_get_new_numbers() -> None:
    shuffled = np.random.default_rng(1).permutation(WALL + BALL)
    assert not same_rows(frame(0), frame(1)[shuffled])


def test_unmoved_points_are_recognized_in_other_rows() -> None:
    identities = Identities()
    before = identities.of(frame(0))
    order = np.random.default_rng(1).permutation(WALL + BALL)
    kept = order[: WALL + BALL - 7]
    after = identities.of(frame(1)[kept])
    rests = kept < WALL
    assert (after[rests] == before[kept[rests]]).all()
    assert (after[~rests] >= WALL + BALL).all()
    assert len(np.unique(after)) == len(kept)


def test_coinciding_points_are_not_confused() -> None:
    identities = Identities()
    twice = Gaussians.concatenate([scene()[:10], scene()[:3]])
    identities.of(twice)
    after = identities.of(scene()[:10])
    assert (after[:3] >= 13).all()
    assert after[3:].tolist() == list(range(3, 10))
