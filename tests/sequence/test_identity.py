import numpy as np

from splatreel.scene.gaussians import Gaussians
from splatreel.sequence.identity import Identities, same_rows
from tests.sequence.films import BALL, WALL, frame, scene


def test_points_in_the_same_rows_are_the_same_however_they_move() -> None:
    identities = Identities()
    numbers = [identities.of(frame(number)) for number in (0, 1, 30)]
    for some in numbers:
        assert some.tolist() == list(range(WALL + BALL))
    assert identities.count == WALL + BALL


def test_points_that_are_shuffled_are_not_taken_for_one_another() -> None:
    shuffled = np.random.default_rng(1).permutation(WALL + BALL)
    assert not same_rows(frame(0), frame(1)[shuffled])


def test_of_other_rows_those_that_have_not_moved_are_recognized() -> None:
    identities = Identities()
    before = identities.of(frame(0))
    order = np.random.default_rng(1).permutation(WALL + BALL)
    kept = order[: WALL + BALL - 7]
    after = identities.of(frame(1)[kept])
    rests = kept < WALL
    assert (after[rests] == before[kept[rests]]).all()
    assert (after[~rests] >= WALL + BALL).all()
    assert len(np.unique(after)) == len(kept)


def test_of_points_at_one_place_none_is_taken_for_another() -> None:
    identities = Identities()
    twice = Gaussians.concatenate([scene()[:10], scene()[:3]])
    identities.of(twice)
    after = identities.of(scene()[:10])
    assert (after[:3] >= 13).all()
    assert after[3:].tolist() == list(range(3, 10))
