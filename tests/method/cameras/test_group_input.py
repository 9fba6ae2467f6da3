"""The input of a group's stages, with smaller images."""

import numpy as np
import pytest

from splatreel.method.cameras import group_input
from tests.method import inputs
from tests.method.scenes import random_gaussians, ring


def test_images_are_halved_as_long_as_they_are_too_large(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(group_input, "ENOUGH_SIDE", 60)
    cameras = ring(2, width=122, height=80)
    images = np.full((3, 2, 80, 122, 3), 90, np.uint8)
    images[:, :, :40] = 10
    data = inputs.group_input(images, cameras)
    small = data.smaller()
    assert small.images.shape == (3, 2, 20, 30, 3)
    assert (small.images[:, :, :10] == 10).all()
    assert (small.images[:, :, 10:] == 90).all()
    assert [(camera.width, camera.height) for camera in small.cameras] == [(30, 20)] * 2
    assert data.images.shape == (3, 2, 80, 122, 3)


def test_halved_camera_sees_the_same(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(group_input, "ENOUGH_SIDE", 64)
    cameras = ring(1, width=128, height=80)
    data = inputs.group_input(np.zeros((1, 1, 80, 128, 3), np.uint8), cameras)
    points = random_gaussians(40, 0, sh_degree=0, spread=1.0)
    small = data.smaller()
    shown, expected = small.draw(points, small.cameras[0]), data.draw(points, cameras[0])
    mean = expected.reshape(40, 2, 64, 2, 3).mean((1, 3))
    assert np.abs(shown - mean).mean() < 0.02
    assert expected.max() > 0.2


def test_small_images_stay_as_they_are():
    data = inputs.group_input(np.zeros((1, 1, 80, 122, 3), np.uint8), ring(1, width=122, height=80))
    assert data.smaller() is data
