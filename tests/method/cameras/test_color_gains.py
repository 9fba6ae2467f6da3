"""Color gains of cameras."""

import numpy as np

from splatreel.method.cameras.color_gains import CameraGains


def descend(gains: CameraGains, camera: int, truth: float) -> None:
    """Follow the gradient of the mean square difference of a gray image from one with the true gain."""
    gains.follow([(camera, 0.5 * (gains.values[camera] - truth) / 3)])


def test_gains_are_learned_with_a_mean_of_one():
    gains = CameraGains(3, rate=0.01)
    truth = np.array([0.9, 1.0, 1.1])
    for i in range(600):
        descend(gains, i % 3, truth[i % 3])
    np.testing.assert_allclose(gains.values.mean(0), np.ones(3), rtol=1e-6)
    np.testing.assert_allclose(gains.values[:, 0], truth, atol=0.02)
    assert gains.values.dtype == np.float32


def test_snapshot_restores_gains_and_momentum():
    gains = CameraGains(2, rate=0.01)
    descend(gains, 0, 0.8)
    restore, ends = gains.snapshot(), []
    for _ in range(2):
        restore()
        for _ in range(5):
            descend(gains, 0, 0.8)
        ends.append(gains.values.copy())
    np.testing.assert_array_equal(*ends)


def test_restart_keeps_gains_and_forgets_momentum():
    gains = CameraGains(2)
    descend(gains, 0, 0.8)
    before = gains.values.copy()
    gains.restart()
    np.testing.assert_array_equal(gains.values, before)
    assert gains.adam.steps == 0
    assert not gains.adam.mean.any()


def test_gains_are_loaded():
    gains = CameraGains(2, enabled=False)
    assert (gains.values == 1).all()
    gains.load(np.array([[0.9, 1, 1], [1.1, 1, 1]]))
    assert gains.values[1, 0] == np.float32(1.1)
