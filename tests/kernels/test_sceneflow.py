"""Scene flow compared with numpy, and on optical flow made from a known motion."""

import numpy as np

from splatreel.kernels import sceneflow
from tests.method.scenes import ring

CAMERAS = ring(6, width=64, height=48)
POSES, LENSES = np.stack([c.viewmat for c in CAMERAS]), np.stack([c.K for c in CAMERAS])
NEAR = 0.5
OPEN = np.full((6, 24, 32), np.inf, np.float32)


def points(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return points [N, 3], some invisible in some views, and their previous motion."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, 1, (80, 3)).astype(np.float32), rng.normal(0, 0.1, (80, 3)).astype(np.float32)


def expected(means, last, fields, depths):
    motion, certainty = np.empty((len(means), 3)), np.empty(len(means))
    for i, mean in enumerate(means.astype(np.float64)):
        rows, flows = [], []
        for V, K, field, depth in zip(POSES.astype(np.float64), LENSES.astype(np.float64), fields, depths, strict=True):
            X, Y, Z = V[:3, :3] @ mean + V[:3, 3]
            u, v = K[0, 0] * X / Z + K[0, 2], K[1, 1] * Y / Z + K[1, 2]
            if Z <= NEAR or not (0 <= u < 64 and 0 <= v < 48) or 1.03 * depth[int(v) // 2, int(u) // 2] < Z:
                continue
            lens = [[K[0, 0] / Z, 0, -K[0, 0] * X / Z**2], [0, K[1, 1] / Z, -K[1, 1] * Y / Z**2]]
            rows.append(np.array(lens) @ V[:3, :3])
            flows.append(field[int(v), int(u)].astype(np.float64))
        weights, motion[i] = np.ones(len(rows)), last[i]
        for turn in range(3):
            if turn:
                errors = [np.sum((J @ motion[i] - f) ** 2) for J, f in zip(rows, flows, strict=True)]
                weights = 1 / (1 + np.array(errors))
            A = sum((w * J.T @ J for w, J in zip(weights, rows, strict=True)), np.zeros((3, 3)))
            b = sum((w * J.T @ f for w, J, f in zip(weights, rows, flows, strict=True)), np.zeros(3))
            damping = 1e-3 * max(np.trace(A), 1e-9)
            motion[i] = np.linalg.solve(A + damping * np.eye(3), b + damping * last[i])
        certainty[i] = max(weights.sum() - 1, 0)
    return motion, certainty


def test_sceneflow_equals_numpy() -> None:
    means, last = points()
    rng = np.random.default_rng(1)
    fields = rng.normal(0, 2, (6, 48, 64, 2)).astype(np.float16)
    depths = np.where(rng.uniform(size=OPEN.shape) < 0.3, 3.9, OPEN).astype(np.float32)
    motion, certainty = sceneflow.solve(means, last, POSES, LENSES, fields, depths, NEAR)
    true_motion, true_certainty = expected(means, last, fields, depths)
    assert 0 < (true_certainty == 0).sum() < len(means)
    np.testing.assert_allclose(motion, true_motion, rtol=1e-3, atol=2e-5)
    np.testing.assert_allclose(certainty, true_certainty, rtol=1e-3, atol=1e-4)


def test_sceneflow_reads_only_needed_pixels() -> None:
    means, last = points()
    rng = np.random.default_rng(1)
    fields = rng.normal(0, 2, (6, 48, 64, 2)).astype(np.float16)
    depths = np.where(rng.uniform(size=OPEN.shape) < 0.3, 3.9, OPEN).astype(np.float32)
    needed = sceneflow.pixels_needed(means, POSES, LENSES, depths, 48, 64, NEAR)
    assert needed.shape == (6, 48, 64)
    assert 0 < needed.sum() <= 6 * len(means)
    motion, _ = sceneflow.solve(means, last, POSES, LENSES, fields, depths, NEAR)
    others = np.where(needed[..., None], fields, np.float16(100))
    np.testing.assert_array_equal(sceneflow.solve(means, last, POSES, LENSES, others, depths, NEAR)[0], motion)
    for camera, row, column in np.argwhere(needed)[::7]:
        changed = fields.copy()
        changed[camera, row, column] += 5
        assert (sceneflow.solve(means, last, POSES, LENSES, changed, depths, NEAR)[0] != motion).any()


def test_sceneflow_recovers_known_motion() -> None:
    means, _ = points()
    moved = np.array([0.02, -0.03, 0.01], np.float32)
    mean, fields = means[:1] * 0.2, np.zeros((6, 48, 64, 2), np.float16)
    for camera, field in zip(CAMERAS, fields, strict=True):
        before, after = (
            (m @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]) @ camera.K.T for m in (mean, mean + moved)
        )
        field[:] = (after[:, :2] / after[:, 2:] - before[:, :2] / before[:, 2:])[0]
    motion, certainty = sceneflow.solve(mean, np.zeros_like(mean), POSES, LENSES, fields, OPEN, NEAR)
    np.testing.assert_allclose(motion[0], moved, atol=1e-3)
    assert certainty[0] > 4


def test_invisible_point_keeps_its_motion() -> None:
    means, last = points()
    fields, walls = np.zeros((6, 48, 64, 2), np.float16), np.ones_like(OPEN)
    motion, certainty = sceneflow.solve(means, last, POSES, LENSES, fields, walls, NEAR)
    np.testing.assert_allclose(motion, last, rtol=1e-5)
    assert not certainty.any()
