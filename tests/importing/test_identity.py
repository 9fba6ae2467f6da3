from dataclasses import replace

import numpy as np

from splatreel.importing.identity import Identities, same_rows
from splatreel.scene.gaussians import Gaussians
from tests.importing.films import BALL, WALL, frame, scene


def test_points_in_the_same_rows_keep_their_numbers() -> None:
    identities = Identities()
    numbers = [identities.of(frame(number)) for number in (0, 1, 30)]
    for some in numbers:
        assert some.tolist() == list(range(WALL + BALL))
    assert identities.count == WALL + BALL


def test_shuffled_points_get_new_numbers() -> None:
    shuffled = np.random.default_rng(1).permutation(WALL + BALL)
    assert not same_rows(frame(0), frame(1)[shuffled])


def follow(frames: list[Gaussians]) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the points of the last frame, and how many numbers were given."""
    identities = Identities()
    for points in frames:
        numbers = identities.of(points)
    return numbers, np.array(identities.count)


def test_shuffled_points_keep_their_numbers() -> None:
    order = np.random.default_rng(1).permutation(WALL + BALL)
    kept = order[: WALL + BALL - 7]
    after, count = follow([frame(0), frame(1)[kept]])
    assert after.tolist() == kept.tolist()
    assert count == WALL + BALL


def test_points_whose_color_and_scale_change_are_found_by_place() -> None:
    rng = np.random.default_rng(2)
    order = rng.permutation(WALL + BALL)
    points = frame(1)[order]
    sh, scales = points.sh.copy(), points.scales * np.exp(0.02 * rng.normal(size=points.scales.shape))
    sh[:, 0] += 0.01 * rng.normal(size=sh[:, 0].shape)
    after, count = follow([frame(0), replace(points, sh=sh, scales=scales)])
    assert (after == order).mean() > 0.97
    assert len(np.unique(after)) == len(after)
    assert count <= 1.03 * (WALL + BALL)


def test_motion_is_expected_to_go_on() -> None:
    fast = [replace(frame(0), means=frame(0).means + np.array([3.0 * number, 0, 0])) for number in range(2)]
    order = np.random.default_rng(3).permutation(WALL + BALL)
    last = replace(frame(0), means=frame(0).means + np.array([6.0, 0, 0]), scales=1.001 * frame(0).scales)[order]
    after, _ = follow([*fast, last])
    assert (after == order).all()


def test_other_points_get_new_numbers() -> None:
    after, _ = follow([frame(0), replace(frame(0), means=frame(0).means + 50, scales=2 * frame(0).scales)[::-1]])
    assert (after >= WALL + BALL).all()


def test_empty_frames_and_points_that_come_back() -> None:
    empty = frame(0)[:0]
    assert follow([empty, frame(0)])[0].tolist() == list(range(WALL + BALL))
    assert (follow([frame(0), empty, frame(0)])[0] >= WALL + BALL).all()


def test_coinciding_points_are_not_confused() -> None:
    twice = Gaussians.concatenate([scene()[:10], scene()[:3]])
    after, _ = follow([twice, scene()[:10]])
    assert len(np.unique(after)) == 10
    assert after[3:].tolist() == list(range(3, 10))
