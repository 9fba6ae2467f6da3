import numpy as np

from splatreel.motion.exposure import even_out, exposures

FRAMES, CAMERAS = 8, 9


def filmed(drift: np.ndarray, cover: float = 0.0, noise: float = 0.5) -> np.ndarray:
    """[T, C, H, W, 3] of textured walls, brighter by drift [T, C, 3], a logarithm; a patchwork that changes covers part of them."""
    rng = np.random.default_rng(0)
    film = np.empty((FRAMES, CAMERAS, 72, 128, 3), np.uint8)
    for c in range(CAMERAS):
        wall = rng.uniform(40, 200, (18, 32, 3)).repeat(4, 0).repeat(4, 1)
        for t in range(FRAMES):
            picture = wall.copy()
            wide = round(cover * 128)
            picture[:, :wide] = rng.uniform(20, 220, (72, wide, 3)).mean(2, keepdims=True)
            patches = rng.uniform(20, 220, (9, wide // 8, 3)).repeat(8, 0).repeat(8, 1)
            picture[:, : patches.shape[1]] = patches
            film[t, c] = np.rint(picture * np.exp(drift[t, c]) + rng.normal(0, noise, picture.shape)).clip(0, 255)
    return film


def drifting() -> np.ndarray:
    """Each camera's exposure goes its own way, by up to five percent, and its colors a little apart."""
    rng = np.random.default_rng(1)
    phase, colors = rng.uniform(0, 6.3, CAMERAS), rng.uniform(0.9, 1.1, (CAMERAS, 3))
    waves = 0.05 * np.sin(phase + 0.5 * np.arange(FRAMES)[:, None])
    return (waves - waves[0])[..., None] * colors


def test_each_camera_s_own_change_is_found() -> None:
    drift = drifting()
    assert np.abs(exposures(filmed(drift))[0] - drift).max() < 0.005


def test_what_moves_may_cover_most_of_a_picture() -> None:
    drift = drifting()
    assert np.abs(exposures(filmed(drift, cover=0.7))[0] - drift).max() < 0.006


def test_pictures_are_even_afterwards() -> None:
    film, drift = filmed(drifting(), noise=0), drifting()
    even_out(film, exposures(film)[0])
    assert np.abs(film.astype(float) - film[0]).max() <= 2
    assert np.abs(drift).max() > 0.03


def test_what_does_not_change_is_not_touched() -> None:
    film = filmed(np.zeros((FRAMES, CAMERAS, 3)), cover=0.3)
    before = film.copy()
    even_out(film, exposures(film)[0])
    assert np.array_equal(film, before)


def test_light_that_all_cameras_see_is_told_from_their_exposures() -> None:
    drift = drifting()
    cloud = np.linspace(0, -0.2, FRAMES)[:, None, None]
    own, light = exposures(filmed(drift + cloud))
    assert np.abs(own.mean(1)).max() < 0.2 * 0.2  # most of it
    assert np.abs(own + light[:, None] - drift - cloud).max() < 0.005
    alone, light = exposures(filmed(np.broadcast_to(cloud, drift.shape)))
    assert np.abs(alone).max() < 0.006
    assert np.abs(light - cloud[:, 0]).max() < 0.003


def test_cameras_that_go_their_own_ways_are_no_light() -> None:
    drift = drifting()
    assert np.all(exposures(filmed(drift - drift.mean(1, keepdims=True)))[1] == 0)


def test_white_stays_white() -> None:
    film = np.full((1, 1, 8, 8, 3), 255, np.uint8)
    even_out(film, np.full((1, 1, 3), 0.1, np.float32))
    assert np.all(film == 255)


def test_white_walls_are_as_grey_as_they_were_in_dim_light() -> None:
    film = np.full((2, 1, 8, 8, 3), 150, np.uint8)
    film[1] = 255  # 1.7 times as bright
    even_out(film, np.array([0, np.log(1.7)], np.float32)[:, None, None].repeat(3, 2))
    assert np.all(film == 150)


def test_a_frame_that_shows_something_else_takes_its_neighbors_exposure() -> None:
    drift = np.linspace(0, 0.07, FRAMES)[:, None, None] * np.linspace(-1, 1, CAMERAS)[None, :, None] * np.ones(3)
    film = filmed(drift)
    film[3] = np.random.default_rng(2).integers(20, 200, (CAMERAS, 9, 16, 3)).repeat(8, 1).repeat(8, 2)
    assert np.abs(exposures(film)[0] - drift).max() < 0.005


def test_black_pictures_and_single_frames_say_nothing() -> None:
    for film in (np.zeros((3, 2, 16, 16, 3), np.uint8), filmed(drifting())[:1]):
        assert all(np.all(change == 0) for change in exposures(film))


def test_light_that_differs_from_wall_to_wall_stays() -> None:
    film = filmed(np.zeros((FRAMES, CAMERAS, 3))).astype(float)
    darker = np.linspace(0, -0.04, 128)[:, None]  # towards the right, where somebody stands in the light
    film *= np.exp(darker * np.linspace(0, 1, FRAMES)[:, None, None, None, None])
    assert all(np.all(change == 0) for change in exposures(np.rint(film).astype(np.uint8)))
