"""Color differences under translations compared with numpy."""

import numpy as np

from splatreel.kernels import translation
from tests.method.scenes import ring

CAMERAS = ring(6, width=40, height=30)
NEAR = 0.8


def expected(points: np.ndarray, motion: np.ndarray, here: np.ndarray, there: np.ndarray, depths: np.ndarray) -> float:
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
    here, there = (rng.integers(0, 256, (6, 30, 40, 3)).astype(np.uint8) for _ in range(2))
    depths = rng.uniform(3, 6, (6, 30, 40)).astype(np.float32)
    depths[depths > 5] = np.inf
    views = np.stack([c.viewmat for c in CAMERAS]), np.stack([c.K for c in CAMERAS])
    found = translation.color_differences(points, motions, *views, here, there, depths, NEAR)
    truth = [expected(points, motion, here, there, depths) for motion in motions]
    assert truth[-1] == 1, "nobody sees what flew away"
    np.testing.assert_allclose(found, truth, rtol=1e-4)
