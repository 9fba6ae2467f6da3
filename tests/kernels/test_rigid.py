"""Rigid moves of patches, compared with plain Python and with known moves."""

import numpy as np
import pytest

from splatreel.kernels import rigid
from splatreel.kernels.rigid import CAP, PAIRS, Template, Views
from splatreel.scene import rotations
from tests.method.scenes import ring

WIDTH, HEIGHT = 96, 64
CAMERAS = ring(4, width=WIDTH, height=HEIGHT)


def views(images: np.ndarray, depth: float = 1e30) -> Views:
    depths = np.full((len(CAMERAS), HEIGHT // 2, WIDTH // 2), depth, np.float32)
    poses, lenses = np.stack([c.viewmat for c in CAMERAS]), np.stack([c.K for c in CAMERAS])
    return Views(poses, lenses, images, depths, np.float32(0.1))


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (len(CAMERAS), HEIGHT, WIDTH, 3)).astype(np.uint8)


def cloud(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.6, 0.6, (count, 3)).astype(np.float32)


def pixels(point: np.ndarray) -> list[tuple[int, int]]:
    """Return row and column of a point in every view."""
    found = []
    for camera in CAMERAS:
        x, y, z = camera.K @ (camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3])
        found.append((int(y / z), int(x / z)))
    return found


def turned(points: np.ndarray, axis: tuple[float, ...], angle: float, shift: tuple[float, ...]) -> np.ndarray:
    unit = np.asarray(axis) / np.linalg.norm(axis)
    quat = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * unit])
    return (points @ rotations.to_matrix(quat[None])[0].T + shift).astype(np.float32)


def test_sample_colors_reads_visible_pixels() -> None:
    points, images = cloud(10), noise(0)
    seen, colors = rigid.sample_colors(points, views(images))
    assert seen.all()
    for i, point in enumerate(points):
        for c, (row, column) in enumerate(pixels(point)):
            np.testing.assert_array_equal(colors[i, c], images[c, row, column])
    wall = views(images)
    wall.depths[1] = 1.0
    seen, hidden = rigid.sample_colors(points, wall)
    assert not seen[:, 1].any()
    assert seen[:, [0, 2, 3]].all()
    np.testing.assert_allclose(hidden[:, 1], colors[:, [0, 2, 3]].mean(1), rtol=1e-5)


def test_color_difference_is_mean_of_capped_differences() -> None:
    points, before, after = cloud(24), noise(1), noise(2)
    seen, colors = rigid.sample_colors(points, views(before))
    found = rigid.color_differences(points, np.arange(24)[None], Template(seen, colors, views(after)))
    expected = [
        min(np.abs(before[c, row, column].astype(float) - after[c, row, column]).mean() / 255, CAP)
        for point in points
        for c, (row, column) in enumerate(pixels(point))
    ]
    assert len(expected) <= PAIRS
    np.testing.assert_allclose(found, np.mean(expected), rtol=1e-5)


def test_rarely_visible_patch_has_neutral_difference_and_capped_cost() -> None:
    points, images = cloud(24), noise(3)
    seen, colors = rigid.sample_colors(points, views(images))
    patch, hidden = np.arange(24)[None], views(noise(4), depth=0.5)
    assert rigid.color_differences(points, patch, Template(seen, colors, hidden))[0] == 0
    assert rigid.color_differences(points + 9, patch, Template(seen, colors, views(noise(4))))[0] == 0
    _, costs = rigid.initial_moves(points, points, points, patch, np.ones(1, bool), Template(seen, colors, hidden))
    assert costs[0] == CAP


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0])
def test_initial_move_fits_flow_or_stays(angle: float) -> None:
    here, patches = cloud(40), np.stack([np.arange(20), np.arange(20, 40)])
    there = turned(here, (1, 2, -1), angle, (0.2, -0.1, 0.3))
    images = views(noise(4))
    template = Template(*rigid.sample_colors(here, images), images)
    moves, _ = rigid.initial_moves(here, here, there, patches, np.zeros(2, bool), template)
    for move, patch in zip(moves, patches, strict=True):
        np.testing.assert_allclose(here[patch] @ move[:, :3].T + move[:, 3], there[patch], atol=1e-5)
    # The images do not change. So the best move is none, whatever the flow and the previous motion are.
    moves, costs = rigid.initial_moves(here, there, there, patches, np.ones(2, bool), template)
    assert costs.max() < 0.02
    np.testing.assert_allclose(moves[:, :, :3], np.broadcast_to(np.eye(3), (2, 3, 3)), atol=1e-6)


def test_refine_moves_adopts_better_move_of_neighbor() -> None:
    here, patches = cloud(48), np.stack([np.arange(24), np.arange(24, 48)])
    images = views(noise(5))
    template = Template(*rigid.sample_colors(here, images), images)
    stay = np.concatenate([np.eye(3), np.zeros((3, 1))], 1).astype(np.float32)
    moves = np.stack([stay, stay])
    moves[1, :, 3] = 0.4
    costs = np.array([0.0, 0.2], np.float32)
    rigid.refine_moves(here, patches, np.array([1]), np.array([[1], [0]]), moves, costs, 1.0, template)
    np.testing.assert_allclose(moves[1], stay, atol=1e-6)
    assert costs[1] < 1e-6
