from dataclasses import replace

import numpy as np

from splatreel.importing.identity import Identities
from splatreel.importing.segments import SegmentBuilder, stretch
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
