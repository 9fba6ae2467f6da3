"""Colors and opacities that change within a group."""

import numpy as np

from splatreel.kernels import adam
from splatreel.method.deform.appearance import LAMBDA, Appearance, detect_cuts


def learn(shade: Appearance, wanted, iterations: int, frames: int) -> None:
    """Follow the gradient of 100 times the mean square error."""
    for i in range(iterations):
        frame = i % frames
        now = shade.at(frame)
        slope = (200 * (now - wanted(frame)) / now.size).astype(np.float32)
        adam.adam(shade.steps(frame, now, slope, i / iterations, 1.0))


def test_appearance_starts_at_zero_and_learns():
    frames = 20
    shade = Appearance(frames, 2)
    assert not shade.at(7.3).any()

    def wanted(frame: float) -> np.ndarray:
        u = frame / (frames - 1)
        return np.array([[0.5 * u, 0, -0.5 * u, -3 * u], [0, 0, 0, 0]])

    learn(shade, wanted, 600, frames)
    for frame in (0, 8, 19, 12.5):
        np.testing.assert_allclose(shade.at(frame), wanted(frame), atol=0.08, rtol=0.1)


def test_appearance_without_gradient_decays_to_zero():
    shade = Appearance(10, 3)
    shade.controls[:] = 2.0
    for i in range(200):
        now = shade.at(i % 10)
        adam.adam(shade.steps(i % 10, now, np.zeros_like(now), i / 200, 1.0))
    assert np.abs(shade.at(5)).max() < 0.01


def test_first_step_has_the_learning_rates_and_pays_for_changes():
    shade = Appearance(10, 3)
    shade.controls[:] = 1.0
    now = shade.at(4)
    [step] = shade.steps(4, now, np.zeros_like(now), 0.0, 1.0)
    np.testing.assert_allclose(step.gradient[0], np.tile(now[0] * LAMBDA / 12, (3, 1)), rtol=1e-6)


def test_appearance_rows_follow_points():
    shade = Appearance(10, 3)
    learn(shade, lambda frame: np.array([[0.1], [0.2], [0.3]]), 20, 10)
    before = shade.at(4.0)
    shade.append(2, np.array([2, 0]))
    shade.append(1, None)
    np.testing.assert_allclose(shade.at(4.0)[:5], before[[0, 1, 2, 2, 0]])
    assert not shade.at(4.0)[5].any()
    shade.keep(np.array([5, 3, 1]))
    np.testing.assert_allclose(shade.at(4.0)[1:], before[[2, 1]])
    assert shade.highest.shape == (3,)
    assert (shade.highest >= shade.at(4.0)[:, 3]).all()
    learn(shade, lambda frame: np.full((3, 4), 0.2), 100, 10)
    np.testing.assert_allclose(shade.at(3), np.full((3, 4), 0.2), atol=0.1)


def test_appearance_starts_from_given_shades():
    wanted = np.zeros((20, 3, 3), np.float32)
    wanted[:, 1] = np.sin(np.arange(20) / 4)[:, None] * np.array([0.5, 0.2, -0.5])
    shade = Appearance(20, 3, wanted)
    for frame in range(20):
        np.testing.assert_allclose(shade.at(frame)[:, :3], wanted[frame], atol=0.08)
        assert not shade.at(frame)[:, 3].any(), "opacities start as they are"


def test_restored_appearance_repeats_its_steps():
    shade = Appearance(10, 3)
    learn(shade, lambda frame: 0.3, 20, 10)
    restore = shade.snapshot()
    ends = []
    for _ in range(2):
        restore()
        learn(shade, lambda frame: -0.3, 20, 10)
        ends.append(shade.controls.copy())
    np.testing.assert_array_equal(*ends)


def make_images(frames: int = 20) -> np.ndarray:
    """Return images [T, 2, 40, 60, 3] uint8 of a bar that moves by a pixel per frame over gray noise."""
    images = np.random.default_rng(0).integers(100, 120, (frames, 2, 40, 60, 3), np.uint8)
    for t in range(frames):
        images[t, :, 5:35, 2 * t : 2 * t + 8] = 220
    return images


def test_detect_cuts_ignores_motion():
    assert detect_cuts(make_images()) == []
    cut = make_images()
    cut[9:, :, 30:, 40:] = 20  # a screen turns dark, and stays dark
    assert detect_cuts(cut) == [9]
    assert detect_cuts(cut[:1]) == []
    assert detect_cuts(cut[:2]) == []


def test_appearance_keeps_cuts_sharp():
    def wanted(frame: float) -> np.ndarray:
        return np.full((1, 4), 0.4 if frame >= 9 else 0.0) * np.array([1.0, -1, 1, 0])

    off = {}
    for cuts in ((), (9,)):
        shade = Appearance(20, 1, cuts=cuts)
        learn(shade, wanted, 1500, 20)
        off[cuts] = max(float(np.abs(shade.at(frame) - wanted(frame)).max()) for frame in range(20))
    assert off[9,] < 0.06
    assert off[()] > 2.5 * off[9,]
