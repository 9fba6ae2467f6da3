"""Photo-consistency compared with numpy."""

import numpy as np

from splatreel.kernels import photo_consistency
from tests.method.scenes import ring

CAMERAS = ring(7, width=40, height=30)
NEAR, LEAST, SHARE = 0.8, 3.0, 0.6


def scene(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return sample points [R, D, 3], colors of rays, images, masks and depths.

    Some points are beside or behind cameras, and some depths are infinite.
    """
    rng = np.random.default_rng(seed)
    places = rng.normal(0, 1.5, (60, 9, 3)).astype(np.float32)
    images = rng.integers(0, 256, (7, 30, 40, 3)).astype(np.uint8)
    own, wrong = rng.uniform(size=(60, 3)).astype(np.float32), rng.uniform(size=(7, 30, 40)) < 0.7
    depths = rng.uniform(3, 6, (7, 30, 40)).astype(np.float32)
    return places, own, images, wrong, np.where(depths > 5, np.float32(np.inf), depths)


def expected(
    places: np.ndarray, own: np.ndarray, images: np.ndarray, wrong: np.ndarray, depths: np.ndarray
) -> np.ndarray:
    flat, colors = places.reshape(-1, 3), np.repeat(own, places.shape[1], 0)
    inside, agree, difference = np.zeros((3, len(flat)))
    for camera, image, mask, shown in zip(CAMERAS, images, wrong, depths, strict=True):
        local = flat @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        pixels = local @ camera.K.T
        u, v = (pixels[:, :2] / pixels[:, 2:]).astype(np.int64).T
        seen = np.flatnonzero((local[:, 2] > NEAR) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height))
        seen = seen[local[seen, 2] <= 1.05 * shown[v[seen], u[seen]]]
        inside[seen] += 1
        hit = seen[mask[v[seen], u[seen]]]
        agree[hit] += 1
        difference[hit] += np.abs(image[v[hit], u[hit]] / 255 - colors[hit]).mean(1)
    held = (agree >= LEAST) & (agree >= SHARE * inside)
    return np.where(held, difference / np.maximum(agree, 1), np.inf).reshape(places.shape[:2])


def test_disagreement_equals_numpy() -> None:
    places, own, images, wrong, depths = scene()
    poses, lenses = np.stack([c.viewmat for c in CAMERAS]), np.stack([c.K for c in CAMERAS])
    found = photo_consistency.disagreement(places, own, poses, lenses, images, wrong, depths, NEAR, LEAST, SHARE)
    truth = expected(places, own, images, wrong, depths)
    assert 0.1 < np.isfinite(truth).mean() < 0.9
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(truth))
    np.testing.assert_allclose(found, truth, rtol=1e-5)


def mean_difference(
    points: np.ndarray, motion: np.ndarray, here: np.ndarray, there: np.ndarray, depths: np.ndarray
) -> float:
    differences: list[float] = []
    for camera, before, after, shown in zip(CAMERAS, here, there, depths, strict=True):
        for point in points:
            places = []
            for place in (point, point + motion):
                local = camera.viewmat[:3, :3] @ place + camera.viewmat[:3, 3]
                u, v = (camera.K @ local)[:2] / local[2]
                if local[2] > NEAR and 0 <= u < camera.width and 0 <= v < camera.height:
                    places.append((int(v), int(u), local[2]))
            if len(places) == 2 and places[0][2] <= 1.05 * shown[places[0][:2]]:
                colors = before[places[0][:2]].astype(float), after[places[1][:2]].astype(float)
                differences.append(np.abs(colors[0] - colors[1]).mean() / 255)
    return float(np.mean(differences)) if differences else 1.0


def test_color_differences_equal_numpy() -> None:
    rng = np.random.default_rng(0)
    points, motions = (rng.normal(0, size, (count, 3)).astype(np.float32) for size, count in ((1.2, 20), (0.5, 15)))
    motions[-1] = 99, 0, 0
    here, there = (rng.integers(0, 256, (7, 30, 40, 3)).astype(np.uint8) for _ in range(2))
    depths = rng.uniform(3, 6, (7, 30, 40)).astype(np.float32)
    depths[depths > 5] = np.inf
    views = np.stack([c.viewmat for c in CAMERAS]), np.stack([c.K for c in CAMERAS])
    found = photo_consistency.color_differences(points, motions, *views, here, there, depths, NEAR)
    truth = [mean_difference(points, motion, here, there, depths) for motion in motions]
    assert truth[-1] == 1, "nobody sees what flew away"
    np.testing.assert_allclose(found, truth, rtol=1e-4)
