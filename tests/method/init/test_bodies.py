"""Bodies within the hull of masks: ghosts between the cameras go, and what a mask shows stays."""

from functools import cache

import numpy as np
import pytest

from splatreel.method.init import bodies
from splatreel.method.init.bodies import subject_hull, with_bodies
from splatreel.method.init.visual_hull import VisualHull
from splatreel.scene.camera import Camera
from splatreel.scene.volumes import Volume
from tests.method.init.people import around, body, landmarks, silhouettes, standing

BALL = np.array([0.75, 0.6, -0.5])


@pytest.fixture(autouse=True)
def few_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bodies, "CELLS", 70)


def person(places: np.ndarray) -> np.ndarray:
    return body(landmarks()).distances(places) < 0


def with_ball(places: np.ndarray) -> np.ndarray:
    return person(places) | (np.linalg.norm(places - BALL, axis=1) < 0.12)


@cache
def masks_of_person() -> np.ndarray:
    return silhouettes(around(4), person)


def hull_of(cameras: list[Camera], masks: np.ndarray) -> VisualHull:
    return VisualHull(cameras, masks.astype(np.uint8) * 255)


def grid(step: float = 0.03) -> np.ndarray:
    axes = [np.arange(-1, 1, step), np.arange(-0.1, 1.9, step), np.arange(-1, 1, step)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def uncovered(cameras: list[Camera], masks: np.ndarray, volume: Volume) -> float:
    """Return the share of the masks' pixels that a volume leaves uncovered."""
    return float((masks & ~silhouettes(cameras, volume.contains)).sum() / masks.sum())


@pytest.mark.parametrize("shape", [person, with_ball])
def test_ghosts_go_and_masks_stay_covered(shape) -> None:
    cameras, places = around(4), grid()
    masks = silhouettes(cameras, shape)
    hull = hull_of(cameras, masks)
    found = with_bodies(hull, [standing()], cameras, masks)
    truth, before, after = shape(places), hull.contains(places), found.contains(places)
    assert after[truth].mean() > 0.99
    assert not (after & ~before).any()
    assert (after & ~truth).sum() < 0.6 * (before & ~truth).sum()
    assert uncovered(cameras, masks, found) <= uncovered(cameras, masks, hull) + 1e-3


def test_a_limb_without_landmarks_stays_covered() -> None:
    cameras = around(4)
    masks = masks_of_person()
    skeleton = standing()
    skeleton.points[[14, 16, 18, 20, 22, 26, 28, 30, 32]] = np.nan
    hull = hull_of(cameras, masks)
    found = with_bodies(hull, [skeleton], cameras, masks)
    assert uncovered(cameras, masks, found) <= uncovered(cameras, masks, hull) + 1e-3


def test_far_places_and_hulls_without_people_are_unchanged() -> None:
    cameras = around(4)
    masks = masks_of_person()
    hull = hull_of(cameras, masks)
    assert with_bodies(hull, [], cameras, masks) is hull


def test_without_networks_the_hull_is_that_of_the_masks(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = around(4)
    masks = masks_of_person()
    monkeypatch.setattr(bodies, "find_people", lambda: None)
    images = np.zeros((*masks.shape, 3), np.uint8)
    assert isinstance(subject_hull(cameras, images, masks.astype(np.uint8) * 255), VisualHull)
