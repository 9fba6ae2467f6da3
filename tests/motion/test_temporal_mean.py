import numpy as np

from splatreel.motion.temporal_mean import temporal_mean


def filmed(noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Twenty frames of two cameras, [T, C, H, W, 3], and the keyframe without noise: a ramp, before which a white square moves on."""
    ramp = np.broadcast_to(np.linspace(60, 190, 64)[None, :, None], (48, 64, 3))
    clean = np.repeat(ramp[None, None], 20, 0).repeat(2, 1).copy()
    for t in range(20):
        clean[t, 0, 10:20, 5 + 2 * t : 15 + 2 * t] = 250
    film = clean + np.random.default_rng(seed).normal(0, noise, clean.shape)
    return np.rint(film).clip(0, 255).astype(np.uint8), clean[0]


def test_noise_of_what_rests_falls() -> None:
    film, clean = filmed(4.0)
    before, after = (
        np.abs(pictures[1] - clean[1]).mean() for pictures in (film[0].astype(float), temporal_mean(film).astype(float))
    )
    assert after < 0.35 * before


def test_what_moves_stays_where_it_is_at_the_keyframe() -> None:
    film, clean = filmed(0.0)
    assert np.abs(temporal_mean(film)[0].astype(float) - clean[0]).max() <= 1


def test_a_slow_change_of_light_is_met_within_the_threshold() -> None:
    film = np.full((11, 1, 16, 16, 3), 100, np.uint8) + np.arange(11, dtype=np.uint8)[:, None, None, None, None]
    found = temporal_mean(film)
    assert np.all((found >= 101) & (found <= 104))


def test_one_frame_stays_as_it_is() -> None:
    film = filmed(4.0)[0][:1]
    assert np.array_equal(temporal_mean(film), film[0])
