from dataclasses import replace

import numpy as np

from splatreel.importing.grouping import FEWEST, Reach, SegmentBuilder, Segments, StaticLayers, group_of, stretch
from splatreel.importing.identity import Identities
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians
from tests.importing.films import BALL, WALL, frame


def built(frames: list[Gaussians]) -> SegmentBuilder:
    identities = Identities()
    return stretch([(points, identities.of(points)) for points in frames])


def unlike(points: Gaussians, rng: np.random.Generator) -> Gaussians:
    """Return points of other places, sizes and colors."""
    means = points.means + 10 * rng.normal(size=points.means.shape)
    scales = points.scales * rng.uniform(2, 5, points.scales.shape)
    return replace(points, means=means, scales=scales, sh=points.sh + rng.normal(size=points.sh.shape))


def test_same_points_form_one_segment_each() -> None:
    builder = built([frame(number) for number in range(8)])
    assert builder.cut(30) == 8
    segments = builder.first(8)
    assert (segments.rows == np.arange(WALL + BALL)).all()
    assert segments.unchanged.tolist() == WALL * [True] + BALL * [False]
    assert segments.numbers.tolist() == list(range(WALL + BALL))


def test_shape_change_starts_a_new_segment() -> None:
    frames = [frame(number) for number in range(6)]
    for number in (3, 4, 5):
        scales = frames[number].scales.copy()
        scales[:5] *= 1.5
        frames[number] = replace(frames[number], scales=scales)
    segments = built(frames).first(6)
    assert segments.rows.shape == (6, WALL + BALL + 5)
    assert (segments.rows[:3, :5] >= 0).all()
    assert (segments.rows[3:, :5] < 0).all()
    assert segments.numbers[-5:].tolist() == list(range(5))
    assert (segments.rows[3:, -5:] == np.arange(5)).all()
    assert not segments.unchanged[:5].any()
    assert not segments.unchanged[-5:].any()
    assert segments.unchanged[5:WALL].all()


def test_slow_shape_changes_accumulate() -> None:
    frames = [frame(number) for number in range(10)]
    frames = [replace(points, scales=points.scales * 1.03**number) for number, points in enumerate(frames)]
    rows = built(frames).first(10).rows
    lengths = (rows >= 0).sum(0)
    assert lengths.max() == 4  # 3 % a frame come to 10 % after three
    assert rows.shape[1] == 3 * (WALL + BALL)


def test_new_points_in_every_frame_give_one_frame_groups() -> None:
    rng = np.random.default_rng(0)
    frames = [unlike(frame(number)[: 400 + number], rng) for number in range(6)]
    builder = built(frames)
    assert builder.cut(30) == 1
    assert not builder.first(1).unchanged.any()


def test_group_ends_where_points_are_exchanged() -> None:
    frames = [frame(number) for number in range(8)]
    others = unlike(frames[4][5:], np.random.default_rng(0))
    frames[4:] = [replace(others, means=others.means + 0.01 * number) for number in range(4)]
    builder = built(frames)
    assert builder.opened == 4 * [WALL + BALL] + 4 * [2 * (WALL + BALL) - 5]
    assert builder.cut(8) == 4
    assert builder.first(4).rows.shape == (4, WALL + BALL)


NEARBY = Reach(np.zeros(3), 1e6)


def test_group_shows_the_points_of_every_frame() -> None:
    frames = [frame(number) for number in range(5)]
    rows = np.broadcast_to(np.arange(WALL, WALL + BALL), (5, BALL))
    group = group_of(3, 12, frames, rows, np.ones(7, bool))
    assert (group.index, group.first_frame, group.frames, len(group.alive)) == (3, 12, 5, 7)
    assert group.shade is None
    for number, points in enumerate(frames):
        shown, ball = group.at(number), points[WALL:]
        np.testing.assert_allclose(shown.means, ball.means, atol=1e-6)
        np.testing.assert_allclose(np.abs((shown.quats * ball.quats).sum(1)), 1, atol=1e-6)


def test_point_is_visible_only_while_present() -> None:
    frames = [frame(number) for number in range(4)]
    rows = np.array([[WALL, -1], [WALL, -1], [-1, WALL + 1], [-1, WALL + 1]])
    group = group_of(0, 0, frames, rows, np.zeros(0, bool))
    shown = [group.at(number) for number in range(4)]
    np.testing.assert_allclose([points.opacities for points in shown], 2 * [[0.9, 0]] + 2 * [[0, 0.9]], atol=1e-6)
    np.testing.assert_allclose(shown[3].means[0], frames[1].means[WALL], atol=1e-6)
    np.testing.assert_allclose(shown[0].means[1], frames[2].means[WALL + 1], atol=1e-6)
    np.testing.assert_allclose(shown[3].means[1], frames[3].means[WALL + 1], atol=1e-6)


def test_colors_and_opacities_follow_the_sequence() -> None:
    frames = [frame(0)[:3] for _ in range(3)]
    bright = frames[1]
    sh = bright.sh.copy()
    sh[:, 0] += 0.2
    frames[1] = Gaussians(bright.means, bright.quats, bright.scales, 0.5 * bright.opacities, sh)
    group = group_of(0, 0, frames, np.broadcast_to(np.arange(3), (3, 3)), np.zeros(0, bool))
    for number, points in enumerate(frames):
        np.testing.assert_allclose(group.at(number).sh, points.sh, atol=1e-6)
        np.testing.assert_allclose(group.at(number).opacities, points.opacities, atol=1e-6)


def test_rotations_take_the_shorter_way() -> None:
    points = frame(0)[:2]
    back = Gaussians(points.means, -points.quats, points.scales, points.opacities, points.sh)
    group = group_of(0, 0, [points, back], np.array([[0, 1], [0, 1]]), np.zeros(0, bool))
    np.testing.assert_allclose(group.dq, np.broadcast_to([1, 0, 0, 0], (2, 2, 4)), atol=1e-6)
    np.testing.assert_allclose(rotations.to_matrix(group.at(0.5).quats), rotations.to_matrix(points.quats), atol=1e-5)


def two_frames(numbers: np.ndarray, moved: int = 0) -> tuple[Gaussians, Segments]:
    """Return the wall twice, its first points displaced, and the resulting split."""
    wall = frame(0)[:WALL]
    means = wall.means.copy()
    means[:moved, 0] += 1
    wall = Gaussians(means, wall.quats, wall.scales, wall.opacities, wall.sh)
    return wall, stretch([(wall, numbers), (wall, numbers)]).first(2)


def test_resting_points_become_static_again() -> None:
    layers, numbers = StaticLayers(1, NEARBY), np.arange(WALL)
    wall, segments = two_frames(numbers)
    alive, born, moving = layers.split([wall], segments)
    assert (len(alive), len(born), len(moving)) == (0, WALL, 0)
    order = np.random.default_rng(0).permutation(WALL)
    layers.add(wall[order], numbers[order])

    gone = FEWEST + 20
    wall, segments = two_frames(numbers, moved=gone)
    alive, born, moving = layers.split([wall], segments)
    assert sorted(order[alive]) == list(range(gone, WALL))
    assert sorted(born) == list(range(gone))
    assert not len(moving)
    layers.add(wall[:gone], numbers[:gone])

    alive, born, moving = layers.split([wall], segments)
    assert (int(alive.sum()), len(born), len(moving)) == (WALL, 0, 0)
    assert alive[WALL:].all()


def test_few_resting_points_stay_dynamic() -> None:
    layers, numbers = StaticLayers(1, NEARBY), np.arange(WALL)
    wall, segments = two_frames(numbers)
    layers.add(wall, numbers)
    wall, segments = two_frames(numbers, moved=FEWEST - 1)
    alive, born, moving = layers.split([wall], segments)
    assert (int(alive.sum()), len(born), moving.tolist()) == (WALL - FEWEST + 1, 0, list(range(FEWEST - 1)))
