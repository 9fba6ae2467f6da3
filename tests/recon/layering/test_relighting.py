"""Points whose light changes."""

import numpy as np

from splatreel.recon.layering.relighting import RelitPoints
from splatreel.scene.gaussians import C0
from tests.recon.scenes import random_gaussians


def test_relit_colors_follow_light() -> None:
    points = random_gaussians(5, sh_degree=1)
    light = np.log(np.linspace(0.5, 1.5, 15)).reshape(3, 5).astype(np.float32)
    lit = RelitPoints(points, light)
    assert len(lit) == 5
    for frame in range(3):
        there = lit.at(frame)
        color, base = 0.5 + C0 * there.sh[:, 0], 0.5 + C0 * points.sh[:, 0]
        np.testing.assert_allclose(color, base * np.exp(light[frame])[:, None], atol=1e-5)
        np.testing.assert_array_equal(there.sh[:, 1:], points.sh[:, 1:])
        np.testing.assert_array_equal(there.opacities, points.opacities)
        np.testing.assert_array_equal(lit.tracks[frame], points.means)


def test_relit_black_stays_black() -> None:
    points = random_gaussians(2)
    points.sh[:, 0] = -3
    assert not RelitPoints(points, np.ones((4, 2), np.float32)).shades.any()
