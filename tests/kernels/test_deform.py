"""Deformed points in a view: known answers, and the same as the kernels one by one."""

import numpy as np
import pytest

from splatreel.kernels import deform, harmonics, project, splat
from splatreel.scene import rotations
from tests.kernels.cases import CENTER, moment
from tests.kernels.compare import camera, floats


@pytest.mark.parametrize("moved", [False, True])
def test_deformed_points_equal_separate_kernels(moved):
    view = project.Pinhole(*camera(60, 40), 60, 40, 0.5, project.FINE_BLUR)
    points = deform.DeformedPoints(*moment(300))
    if not moved:
        points = points._replace(dx=points.dx[:0], dq=points.dq[:0], shade=points.shade[:0])
    opacities, seen = deform.forward(points, CENTER, view)
    means, quats, base, logits = points.means, points.quats, points.base, points.logit_opacities
    if moved:
        means = means + points.dx
        quats = rotations.multiply(quats, rotations.normalize(points.dq)).astype(np.float32)
        base, logits = base + points.shade[:, None, :3], logits + points.shade[:, 3]
    scales = np.exp(points.log_scales)
    projected = splat.project(means, quats, scales, view.viewmat, view.K, 60, 40, 0.5, antialias=True)
    for found, expected in zip((seen.means2d, seen.conics, seen.depths, seen.radii), projected, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(seen.colors, harmonics.colors(means, CENTER, base, points.rest), atol=1e-5)
    plain = 1 / (1 + np.exp(-logits))
    np.testing.assert_allclose(opacities, splat.antialiased(plain, projected.conics), atol=1e-5)


def test_deformation_moves_and_rotates_points():
    """Offsets with an unnormalized dq rotate a long thin point by 90 degrees about z and move it to the center of the image."""
    half = np.array([[2**-0.5, 0, 0, 2**-0.5]], np.float32)
    zeros = np.zeros((1, 1, 3), np.float32)
    points = deform.DeformedPoints(
        means=floats([[0, -1, 0]]),
        quats=floats([[1, 0, 0, 0]]),
        log_scales=np.log(floats([[0.5, 0.01, 0.01]])),
        logit_opacities=np.zeros(1, np.float32),
        base=zeros,
        rest=zeros[:, :0],
        dx=floats([[0, 1, 0]]),
        dq=7 * half,
        shade=floats([[1, 0, -1, 2]]),
    )
    pose, K = np.eye(4, dtype=np.float32), floats([[50, 0, 20], [0, 50, 20], [0, 0, 1]])
    pose[2, 3] = 5
    opacities, seen = deform.forward(points, floats([0, 0, -5]), project.Pinhole(pose, K, 40, 40, 0.1))
    assert seen.means2d.tolist() == [[20, 20]]
    assert seen.depths.tolist() == [5]
    assert seen.radii[0] > 0
    assert 1 / seen.conics[0, 2] == pytest.approx(5**2 + 0.3, rel=1e-4), "it stands upright"
    assert 1 / seen.conics[0, 0] == pytest.approx(0.1**2 + 0.3, rel=1e-4)
    np.testing.assert_allclose(seen.colors, [[0.5 + 0.28209479, 0.5, 0.5 - 0.28209479]], rtol=1e-5)
    np.testing.assert_allclose(opacities, 1 / (1 + np.exp(-2.0)), rtol=1e-6)
