"""Groups at times, and the division of videos into groups."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatreel.base.errors import GaussiansError, UsageError
from splatreel.scene import rotations
from splatreel.scene.group import Group, group_spans
from tests.golden import random_gaussians, random_motion


def group(count=5, frames=4):
    rng = np.random.default_rng(0)
    dynamic = random_gaussians(rng, count, 1, (0, 0, 0))
    dx, dq = random_motion(rng, dynamic, frames)
    return Group(0, 10, dynamic, dx, dq, np.ones(3, bool))


@pytest.mark.parametrize("frame", [0, 2, 3])
def test_at_returns_points_of_a_frame(frame):
    g = group()
    expected = g.dynamic.moved(g.dx[frame], g.dq[frame])
    np.testing.assert_allclose(g.at(frame).means, expected.means, atol=1e-6)
    np.testing.assert_allclose(np.abs((g.at(frame).quats * expected.quats).sum(1)), 1, atol=1e-5)


def test_at_interpolates_between_frames():
    g = group()
    np.testing.assert_allclose(g.at(1.25).means, g.dynamic.means + 0.75 * g.dx[1] + 0.25 * g.dx[2], atol=1e-6)


def test_at_takes_the_shorter_rotation():
    g = group()
    flipped = g.dq.copy()
    flipped[1] *= -1
    other = Group(0, 10, g.dynamic, g.dx, flipped, g.alive)
    same = np.abs((other.at(0.5).quats * g.at(0.5).quats).sum(1))
    np.testing.assert_allclose(same, 1, atol=1e-5)


@pytest.mark.parametrize(("outside", "inside"), [(-5, 0), (99, 3), (3.5, 3)])
def test_at_clamps_frames(outside, inside):
    np.testing.assert_array_equal(group().at(outside).means, group().at(inside).means)


def test_group_of_one_frame():
    g = group(frames=1)
    np.testing.assert_allclose(g.at(0.7).means, g.dynamic.means + g.dx[0], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rotations.normalize(g.at(0).quats), axis=1), 1, atol=1e-6)


def test_shade_is_interpolated_and_opacities_are_clamped():
    g = group()
    shade = np.zeros((4, 5, 4), np.float32)
    shade[2] = 0.4, 0, 0, -2
    shaded = dataclasses.replace(g, shade=shade)
    np.testing.assert_array_equal(shaded.at(0).sh, g.at(0).sh)
    np.testing.assert_allclose(shaded.at(1.5).sh[:, 0, 0], g.dynamic.sh[:, 0, 0] + 0.2, atol=1e-6)
    np.testing.assert_array_equal(shaded.at(1.5).sh[:, 1:], g.dynamic.sh[:, 1:])
    np.testing.assert_array_equal(shaded.at(2).opacities, 0)
    np.testing.assert_array_equal(shaded.at(2).means, g.at(2).means)
    with pytest.raises(GaussiansError, match="shade"):
        dataclasses.replace(g, shade=shade[:3])


def test_light_is_interpolated_and_clamped():
    g = group()
    assert g.light_at(1) is None
    light = np.linspace((1, 1, 1), (0.7, 0.4, 1.6), 4, dtype=np.float32)
    lit = dataclasses.replace(g, light=light)
    between = lit.light_at(1.5)
    assert between is not None
    np.testing.assert_allclose(between, (light[1] + light[2]) / 2, atol=1e-6)
    np.testing.assert_array_equal(lit.light_at(99), light[3])
    np.testing.assert_array_equal(lit.at(1.5).sh, g.at(1.5).sh)
    with pytest.raises(GaussiansError, match="light"):
        dataclasses.replace(g, light=light[:3])


@pytest.mark.parametrize(("frames", "count"), [(4, 6), (4, 4)])
def test_wrong_offset_shapes_are_refused(frames, count):
    g = group()
    with pytest.raises(GaussiansError, match="do not fit 5"):
        Group(0, 0, g.dynamic, np.zeros((frames, count, 3)), np.zeros((frames, count, 4)), g.alive)
    with pytest.raises(GaussiansError, match="no frame"):
        Group(0, 0, g.dynamic, np.zeros((0, 5, 3)), np.zeros((0, 5, 4)), g.alive)


def test_consecutive_groups_overlap():
    assert [(s.first, s.own, s.count) for s in group_spans(60, 30, 5)] == [(0, 30, 35), (30, 30, 30)]


def test_short_remainder_joins_the_previous_group():
    assert [(s.first, s.count) for s in group_spans(33, 30, 5)] == [(0, 33)]
    assert [(s.first, s.count) for s in group_spans(36, 30, 5)] == [(0, 35), (30, 6)]


def test_one_frame_is_one_group():
    assert [(s.first, s.own, s.count) for s in group_spans(1, 30, 5)] == [(0, 1, 1)]


def test_overlap_longer_than_a_group_is_refused():
    with pytest.raises(UsageError, match="overlap of 30"):
        group_spans(60, 30, 30)


@given(st.integers(1, 400), st.integers(2, 60), st.data())
def test_groups_cover_every_frame_once(frames, length, data):
    overlap = data.draw(st.integers(0, length - 1))
    cut = group_spans(frames, length, overlap)
    assert sum(s.own for s in cut) == frames
    assert cut[-1].first + cut[-1].count == frames
    for a, b in itertools.pairwise(cut):
        assert b.first == a.first + a.own
        assert a.count == min(a.own + overlap, frames - a.first)
