"""Temporal means of keyframe images."""

import numpy as np

from splatreel.method.images.temporal_mean import temporal_mean


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
