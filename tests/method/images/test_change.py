"""Changing pixels: a square crosses the image of one camera, nothing changes for the other."""

import numpy as np

from splatreel.method.images.change import changed_pixels


def filmed(noise: float, flicker: float = 0.0, frames: int = 12) -> np.ndarray:
    rng = np.random.default_rng(0)
    film = np.broadcast_to(np.linspace(60, 190, 64)[:, None], (frames, 2, 48, 64, 3)).copy()
    for t in range(1, frames):
        film[t, 0, 10:20, 5 + 3 * t : 15 + 3 * t] = 250
    film += flicker * rng.normal(size=(frames, 1, 1, 1, 1)) + noise * rng.normal(size=film.shape)
    return np.rint(film).clip(0, 255).astype(np.uint8)


def test_changes_are_where_square_moves() -> None:
    found = changed_pixels(filmed(3.0))
    assert found.shape == (2, 48, 64)
    assert found[0, 12:18, 10:46].all()
    assert not found[0, 24:].any()
    assert not found[1].any()


def test_changes_ignore_noise_and_flicker() -> None:
    for film in (filmed(12.0), filmed(2.0, flicker=10)):
        found = changed_pixels(film)
        assert found[0, 12:18, 10:46].mean() > 0.9
        assert found[0, 24:].mean() < 0.05
        assert found[1].mean() < 0.05


def test_changes_of_one_frame_are_empty() -> None:
    assert not changed_pixels(filmed(3.0)[:1]).any()
