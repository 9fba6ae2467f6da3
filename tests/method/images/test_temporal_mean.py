"""Temporal means of keyframe images."""

import numpy as np
import pytest

from splatreel.method.images.temporal_mean import clean_plates, temporal_mean


def filmed(noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return twenty frames [T, C, H, W, 3] of two cameras and the keyframe without noise: a white square moves over a ramp."""
    ramp = np.broadcast_to(np.linspace(60, 190, 64)[None, :, None], (48, 64, 3))
    clean = np.repeat(ramp[None, None], 20, 0).repeat(2, 1).copy()
    for t in range(20):
        clean[t, 0, 10:20, 5 + 2 * t : 15 + 2 * t] = 250
    film = clean + np.random.default_rng(seed).normal(0, noise, clean.shape)
    return np.rint(film).clip(0, 255).astype(np.uint8), clean[0]


def test_temporal_mean_reduces_noise() -> None:
    film, clean = filmed(4.0)
    before, after = (
        np.abs(images[1] - clean[1]).mean() for images in (film[0].astype(float), temporal_mean(film).astype(float))
    )
    assert after < 0.35 * before


def test_temporal_mean_keeps_moving_pixels() -> None:
    film, clean = filmed(0.0)
    assert np.abs(temporal_mean(film)[0].astype(float) - clean[0]).max() <= 1


def test_temporal_mean_averages_slow_light_change() -> None:
    film = np.full((11, 1, 16, 16, 3), 100, np.uint8) + np.arange(11, dtype=np.uint8)[:, None, None, None, None]
    found = temporal_mean(film)
    assert np.all((found >= 101) & (found <= 104))


def test_temporal_mean_of_one_frame() -> None:
    film = filmed(4.0)[0][:1]
    assert np.array_equal(temporal_mean(film), film[0])


FRAMES, HEIGHT, WIDTH = 24, 32, 48
BACKGROUND = np.broadcast_to(np.linspace(60, 190, WIDTH)[:, None], (HEIGHT, WIDTH, 3))


def filmed_with_person(noise: float = 0.0) -> np.ndarray:
    """Return frames [S, C, H, W, 3] float of two cameras that show a static ramp."""
    film = np.broadcast_to(BACKGROUND, (FRAMES, 2, HEIGHT, WIDTH, 3)).copy()
    return film + np.random.default_rng(0).normal(0, noise, film.shape)


def plates(film: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """images: [C, H, W, 3] float. unknown: [C, H, W] bool."""
    found = clean_plates(np.rint(film).clip(0, 255).astype(np.uint8))
    assert found.images.dtype == np.uint8
    return found.images.astype(float), found.unknown


def test_clean_plate_of_static_scene_removes_noise() -> None:
    images, unknown = plates(filmed_with_person(noise=4.0))
    assert np.abs(images - BACKGROUND).mean() < 1.0, "a single frame is off by 3.2"
    assert not unknown.any()


def test_clean_plate_removes_passing_object() -> None:
    film = filmed_with_person()
    for frame in range(FRAMES):
        film[frame, 0, 8:24, 2 * frame - 6 : 2 * frame] = 250
    images, unknown = plates(film)
    assert np.abs(images - BACKGROUND).max() <= 1
    assert not unknown.any()


@pytest.mark.parametrize(("share", "there"), [(0.75, True), (0.25, False)])
def test_clean_plate_contains_majority_content(share: float, there: bool) -> None:
    film = filmed_with_person()
    film[: round(share * FRAMES), 0, 8:24, 10:26] = 250
    images, unknown = plates(film)
    expected = BACKGROUND.copy()
    if there:
        expected[8:24, 10:26] = 250
    edge = np.zeros((HEIGHT, WIDTH), bool)  # frames are compared over a neighborhood of each pixel
    edge[5:27, 7:29] = True
    edge[11:21, 13:23] = False
    assert np.abs(images[0] - expected)[~edge].max() <= 1
    assert not unknown[0][~edge].any()


def test_clean_plate_is_unknown_without_majority() -> None:
    film = filmed_with_person()
    for frame in range(FRAMES):
        film[frame, 1, 8:24, 10:26] = (20, 130, 240)[frame % 3]
    _, unknown = plates(film)
    assert unknown[1, 11:21, 13:23].all()
    assert not unknown[1, :5].any()
    assert not unknown[0].any()


def test_clean_plate_averages_drifting_light() -> None:
    film = filmed_with_person() + np.linspace(-4, 4, FRAMES)[:, None, None, None, None]
    images, unknown = plates(film)
    assert np.abs(images - BACKGROUND).max() <= 1
    assert not unknown.any()


def test_clean_plate_of_one_frame() -> None:
    film = filmed_with_person(noise=4.0)[:1]
    images, unknown = plates(film)
    assert np.array_equal(images, np.rint(film[0]).clip(0, 255))
    assert not unknown.any()


def test_clean_plate_excludes_standing_person() -> None:
    """The folds of a shirt differ by less than the limit of the mean, so the plate has a smear there."""
    film = filmed_with_person(noise=1.0)
    for frame in range(FRAMES):
        film[frame, 0, 6:26, 8:28] = 110 + 8 * np.sin(0.3 * np.arange(20) + 1.7 * frame)[:, None]
    _, unknown = plates(film)
    assert unknown[0, 10:22, 12:24].mean() > 0.9
    assert not unknown[0, :2].any()
    assert not unknown[0, :, 32:].any()
    assert not unknown[1].any()
