"""Exposure and light of synthetic captures."""

import numpy as np

from splatreel.method.cameras.exposure import even_out, exposures
from tests.any_threads import assert_same_on_any_threads

FRAMES, CAMERAS = 8, 9


def filmed(drift: np.ndarray, cover: float = 0.0, noise: float = 0.5) -> np.ndarray:
    """Return [T, C, H, W, 3] textured walls, brightened by drift [T, C, 3] (logarithms); a changing patchwork covers a part."""
    rng = np.random.default_rng(0)
    film = np.empty((FRAMES, CAMERAS, 72, 128, 3), np.uint8)
    for c in range(CAMERAS):
        wall = rng.uniform(40, 200, (18, 32, 3)).repeat(4, 0).repeat(4, 1)
        for t in range(FRAMES):
            image = wall.copy()
            wide = round(cover * 128)
            image[:, :wide] = rng.uniform(20, 220, (72, wide, 3)).mean(2, keepdims=True)
            patches = rng.uniform(20, 220, (9, wide // 8, 3)).repeat(8, 0).repeat(8, 1)
            image[:, : patches.shape[1]] = patches
            film[t, c] = np.rint(image * np.exp(drift[t, c]) + rng.normal(0, noise, image.shape)).clip(0, 255)
    return film


def drifting() -> np.ndarray:
    """Return a drift of up to five percent per camera, slightly different per color."""
    rng = np.random.default_rng(1)
    phase, colors = rng.uniform(0, 6.3, CAMERAS), rng.uniform(0.9, 1.1, (CAMERAS, 3))
    waves = 0.05 * np.sin(phase + 0.5 * np.arange(FRAMES)[:, None])
    return (waves - waves[0])[..., None] * colors


def test_exposures_of_each_camera_are_found() -> None:
    drift = drifting()
    assert np.abs(exposures(filmed(drift))[0] - drift).max() < 0.005


def test_exposures_are_robust_to_large_motion() -> None:
    drift = drifting()
    assert np.abs(exposures(filmed(drift, cover=0.7))[0] - drift).max() < 0.006


def test_even_out_removes_exposure() -> None:
    film, drift = filmed(drifting(), noise=0), drifting()
    even_out(film, exposures(film)[0])
    assert np.abs(film.astype(float) - film[0]).max() <= 2
    assert np.abs(drift).max() > 0.03


def test_evened_images_are_the_same_on_any_threads() -> None:
    film = filmed(drifting())

    def evened() -> np.ndarray:
        images = film.copy()
        even_out(images, exposures(images)[0])
        return images

    assert_same_on_any_threads(evened)


def test_exposures_of_constant_capture_are_zero() -> None:
    film = filmed(np.zeros((FRAMES, CAMERAS, 3)), cover=0.3)
    before = film.copy()
    even_out(film, exposures(film)[0])
    assert np.array_equal(film, before)


def test_exposures_separate_common_light() -> None:
    drift = drifting()
    cloud = np.linspace(0, -0.2, FRAMES)[:, None, None]
    own, light = exposures(filmed(drift + cloud))
    assert np.abs(own.mean(1)).max() < 0.2 * 0.2  # most of the drift
    assert np.abs(own + light[:, None] - drift - cloud).max() < 0.005
    alone, light = exposures(filmed(np.broadcast_to(cloud, drift.shape)))
    assert np.abs(alone).max() < 0.006
    assert np.abs(light - cloud[:, 0]).max() < 0.003


def test_independent_exposures_are_no_light() -> None:
    drift = drifting()
    assert np.all(exposures(filmed(drift - drift.mean(1, keepdims=True)))[1] == 0)


def test_even_out_keeps_white() -> None:
    film = np.full((1, 1, 8, 8, 3), 255, np.uint8)
    even_out(film, np.full((1, 1, 3), 0.1, np.float32))
    assert np.all(film == 255)


def test_even_out_darkens_white_after_large_change() -> None:
    film = np.full((2, 1, 8, 8, 3), 150, np.uint8)
    film[1] = 255  # 1.7 times as bright
    even_out(film, np.array([0, np.log(1.7)], np.float32)[:, None, None].repeat(3, 2))
    assert np.all(film == 150)


def test_exposure_of_unrelated_frame_is_interpolated() -> None:
    drift = np.linspace(0, 0.07, FRAMES)[:, None, None] * np.linspace(-1, 1, CAMERAS)[None, :, None] * np.ones(3)
    film = filmed(drift)
    film[3] = np.random.default_rng(2).integers(20, 200, (CAMERAS, 9, 16, 3)).repeat(8, 1).repeat(8, 2)
    assert np.abs(exposures(film)[0] - drift).max() < 0.005


def test_exposures_of_black_or_single_frames_are_zero() -> None:
    for film in (np.zeros((3, 2, 16, 16, 3), np.uint8), filmed(drifting())[:1]):
        assert all(np.all(change == 0) for change in exposures(film))


def test_exposures_ignore_local_light() -> None:
    film = filmed(np.zeros((FRAMES, CAMERAS, 3))).astype(float)
    darker = np.linspace(0, -0.04, 128)[:, None]  # darker to the right, where somebody blocks the light
    film *= np.exp(darker * np.linspace(0, 1, FRAMES)[:, None, None, None, None])
    assert all(np.all(change == 0) for change in exposures(np.rint(film).astype(np.uint8)))
