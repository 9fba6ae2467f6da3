"""Skeletons of a made-up person, whose landmarks and radii are known."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.method.images.people import People
from splatreel.method.init.skeleton import MAIN, MIRRORED, Capsules, capsules, find_skeletons, match_people
from splatreel.scene.volumes import Sphere
from tests.method.init.people import HEIGHT, around, body, landmarks, seen_by, silhouettes, standing

EVERYWHERE = Sphere(np.zeros(3), 100.0)


def test_four_cameras_give_a_skeleton() -> None:
    cameras, points = around(4), landmarks()
    (found,) = match_people(cameras, seen_by(cameras, points), EVERYWHERE)
    assert np.allclose(found.points, points, atol=1e-4)
    assert found.height == pytest.approx(HEIGHT, rel=0.05)


def test_a_view_that_confuses_left_and_right_agrees_when_mirrored() -> None:
    cameras, points = around(4), landmarks()
    seen = seen_by(cameras, points)
    seen[2] = seen[2].mirrored()
    assert not np.allclose(seen[2].points, seen[2].mirrored().points)
    (found,) = match_people(cameras, seen, EVERYWHERE)
    assert np.allclose(found.points, points, atol=1e-4) or np.allclose(found.points[MIRRORED], points, atol=1e-4)


def test_what_one_camera_sees_elsewhere_is_left_out() -> None:
    cameras, points = around(4), landmarks()
    seen = seen_by(cameras, points)
    wrong = seen[1].points.copy()
    wrong[[15, 27]] += 40
    seen[1] = replace(seen[1], points=wrong)
    (found,) = match_people(cameras, seen, EVERYWHERE)
    assert np.allclose(found.points, points, atol=1e-4)


def test_landmarks_that_no_two_cameras_agree_on_are_unknown() -> None:
    cameras, points = around(4), landmarks()
    seen = seen_by(cameras, points)
    for k, each in enumerate(seen):
        wrong = each.points.copy()
        wrong[15] += 30 * np.array([(k % 2) - 0.5, k - 1.5])
        seen[k] = replace(each, points=wrong)
    (found,) = match_people(cameras, seen, Sphere(np.array([0, 0.85, 0]), 1.0))
    assert np.isnan(found.points[15]).all()
    assert np.allclose(np.delete(found.points, 15, 0), np.delete(points, 15, 0), atol=1e-4)


def test_landmarks_outside_of_the_hull_are_unknown() -> None:
    cameras, points = around(4), landmarks()
    (found,) = match_people(cameras, seen_by(cameras, points), Sphere(np.array([0, 1.7, 0]), 1.5))
    assert np.isnan(found.points[27]).all()
    assert np.isfinite(found.points[[11, 12, 23]]).all()


def test_two_people_are_told_apart() -> None:
    cameras = around(4, 480, 240)
    people = [landmarks() + np.array([0.7, 0, 0]), landmarks() * [-1, 1, -1] - [0.7, 0, 0]]
    seen = [each for points in people for each in seen_by(cameras, points)]
    found = match_people(cameras, seen[::-1], EVERYWHERE)
    assert len(found) == 2
    for points in people:
        assert min(np.abs(each.points[MAIN] - points[MAIN]).max() for each in found) < 1e-3


def test_two_of_four_cameras_are_not_enough() -> None:
    cameras = around(4)
    assert match_people(cameras, seen_by(cameras, landmarks())[:2], EVERYWHERE) == []


def test_radii_follow_the_masks_within_bounds() -> None:
    cameras, truth = around(6, 320, 240), body(landmarks())
    wide = Capsules(truth.starts, truth.ends, 1.3 * truth.radii)
    for shown, expected in ((truth, 1.0), (wide, 1.3)):
        masks = silhouettes(cameras, lambda places, shown=shown: shown.distances(places) < 0)
        found = capsules(standing(), cameras, masks)
        legs = found.radii[[9, 10, 17, 18]] / truth.radii[[9, 10, 17, 18]]
        assert np.allclose(legs, expected, atol=0.2), expected
    nothing = capsules(standing(), cameras, np.zeros_like(masks))
    assert np.allclose(nothing.radii, 0.8 * truth.radii)


def test_distances_from_capsules() -> None:
    shape = Capsules(np.array([[0.0, 0, 0]]), np.array([[2.0, 0, 0]]), np.array([0.5]))
    places = np.array([[1.0, 0, 0], [1, 2, 0], [3, 0, 0], [-1, 0, 0]])
    assert np.allclose(shape.distances(places), [-0.5, 1.5, 0.5, 0.5])


def test_networks_find_a_person_in_all_images() -> None:
    """Networks that see the landmarks of a person wherever a square is: each image holds the number of its camera."""
    cameras, points = around(4), landmarks()
    images = np.stack([np.full((120, 160, 3), 10 * c, np.uint8) for c in range(4)])

    class Known(People):
        def find(self, image, angle=0.0):
            return []

        def landmarks(self, image, square):
            return seen_by(cameras, points)[image[0, 0, 0] // 10]

    masks = silhouettes(cameras, lambda places: body(points).distances(places) < 0)
    (found,) = find_skeletons(cameras, images, masks, EVERYWHERE, Known({}))
    assert np.allclose(found.points, points, atol=1e-4)
