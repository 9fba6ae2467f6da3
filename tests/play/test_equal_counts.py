"""Frames with equal counts: made-up lives of Gaussians, and a reel of several groups."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from splatreel.kernels.image import render_image
from splatreel.play.equal_counts import EqualCounts
from splatreel.play.gaussian_export import GaussianExport
from splatreel.play.timeline import Timeline, open_reel
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.golden import PREDICTIVE


def gaussians(ids: list[int], frame: int, degree: int = 0) -> Gaussians:
    """Return Gaussians whose x is their id and whose y is the frame."""
    n = len(ids)
    means = np.array([[number, frame, 0] for number in ids], np.float32).reshape(n, 3)
    turns = np.tile([(-1.0) ** frame, 0, 0, 0], (n, 1))  # the same rotation, with either sign
    return Gaussians(means, turns, np.ones((n, 3)), np.full(n, 0.5), np.ones((n, (degree + 1) ** 2, 3)))


def film(lives: dict[int, range], frames: int) -> Callable[[float], tuple[Gaussians, np.ndarray]]:
    def at(seconds: float) -> tuple[Gaussians, np.ndarray]:
        ids = [number for number, life in lives.items() if int(seconds) in life]
        return gaussians(ids, int(seconds), degree=1 if seconds == frames - 1 else 0), np.array(ids, np.int64)

    return at


def test_a_slot_that_changes_its_owner_is_invisible_before_and_after() -> None:
    lives = {5: range(4), 9: range(6, 9), 2: range(9), 7: range(5, 9)}
    found = list(EqualCounts(range(9), film(lives, 9)))
    assert {len(frame) for frame in found} == {3}, "5 and 9 share a slot, but 7 begins too early after 5"
    slot = next(k for k in range(3) if found[0].means[k, 0] == 5)
    assert [frame.opacities[slot] for frame in found] == [0.5] * 4 + [0, 0] + [0.5] * 3
    assert found[4].means[slot].tolist() == [5, 3, 0], "where the old one was"
    assert found[5].means[slot].tolist() == [9, 6, 0], "where the new one will be"


def test_gaussians_keep_slots_rotations_and_harmonics() -> None:
    lives = {1: range(6), 2: range(2, 6)}
    found = list(EqualCounts(range(6), film(lives, 6)))
    assert all(frame.sh.shape == (2, 4, 3) for frame in found), "the highest degree of all frames"
    for before, after in itertools.pairwise(found):
        assert (np.sum(before.quats * after.quats, 1) > 0).all(), "rotations take the shorter way"
    for number, life in lives.items():
        slots = {
            k for frame in life for k in range(2) if found[frame].means[k, 0] == number and found[frame].opacities[k]
        }
        assert len(slots) == 1


def test_a_film_in_which_nothing_shows_at_first() -> None:
    found = list(EqualCounts(range(4), film({3: range(2, 4)}, 4)))
    assert [frame.opacities.tolist() for frame in found] == [[0], [0], [0.5], [0.5]]
    assert found[1].means.tolist() == [[3, 2, 0]]


@pytest.fixture(scope="module")
def reel() -> Timeline:
    return open_reel(PREDICTIVE)


@pytest.fixture(scope="module")
def equal(reel: Timeline) -> list[Gaussians]:
    times = [frame / reel.fps for frame in range(reel.frames)]
    return list(GaussianExport(reel, times, None, equal_counts=True))


def test_frames_of_a_reel_are_those_of_the_plain_export(reel: Timeline, equal: list[Gaussians]) -> None:
    assert {len(points) for points in equal} == {max(len(moment) for moment in reel)}
    for points, moment in zip(equal, reel, strict=True):
        shown, plain = points[points.opacities > 0], moment[moment.opacities > 0]
        for name in ("means", "scales", "opacities", "sh"):
            found, expected = (getattr(each, name)[np.lexsort(each.means.T)] for each in (shown, plain))
            np.testing.assert_array_equal(found, expected)


def test_ids_are_constant_within_a_group_and_unique(reel: Timeline) -> None:
    moments = list(reel)
    assert all(len(np.unique(moment.ids)) == len(moment) for moment in moments)
    first = moments[0]
    later = moments[1]
    np.testing.assert_array_equal(first.ids, later.ids)
    still = first.is_static
    np.testing.assert_array_equal(first.means[still], later.means[still])


def blend(first: Gaussians, second: Gaussians) -> Gaussians:
    """Return the frame that a program interpolates half way, by rows."""
    n = min(len(first), len(second))
    halves = [(getattr(first, name)[:n] + getattr(second, name)[:n]) / 2 for name in Gaussians.ARRAYS]
    return Gaussians(*halves)


def test_frames_between_two_are_better_than_those_of_the_plain_export(reel: Timeline, equal: list[Gaussians]) -> None:
    """The rows of plain frames are other points where groups change."""
    camera: Camera = reel.manifest.camera.resized(64, 48)

    def error(points: Gaussians, frame: int) -> float:
        truth = render_image(reel.at((frame + 0.5) / reel.fps), camera)
        return float(np.mean((render_image(points, camera) - truth) ** 2))

    changes = [frame for frame in range(reel.frames - 1) if len(reel[frame]) != len(reel[frame + 1])]
    assert changes
    for frame in changes:
        ours, plain = (
            error(blend(equal[frame], equal[frame + 1]), frame),
            error(blend(reel[frame], reel[frame + 1]), frame),
        )
        assert ours < 0.5 * plain
