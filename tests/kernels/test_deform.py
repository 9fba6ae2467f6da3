"""Deformed points in a view, compared with the twin and with known answers."""

from typing import Any

import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.kernels import splat, twin
from splatreel.kernels.backend import Backend
from splatreel.kernels.backends import BACKENDS
from tests.kernels.compare import assert_parity, camera, gaussians

WIDTH, HEIGHT = 60, 40
PINHOLE: Any = (*camera(WIDTH, HEIGHT), WIDTH, HEIGHT)
CENTER = torch.tensor([0.3, -0.2, -3.0])


def moment(count: int, bands: int = 4, seed: int = 0) -> list[torch.Tensor]:
    """Return unconstrained points, dx, dq and shade."""
    means, quats, scales, _, sh = gaussians(count, bands, seed)
    generator = torch.Generator().manual_seed(seed + 1)
    logits, dx, dq, shade = (
        torch.randn(*shape, generator=generator) for shape in ((count,), *((count, k) for k in (3, 4, 4)))
    )
    return [means, quats, scales.log(), logits, sh[:, :1].clone(), sh[:, 1:].clone(), 0.2 * dx, 3 * dq, 0.3 * shade]


def seen(module, antialias, shaded=True):
    def of(*parts):
        *points, dx, dq, shade = parts if shaded else (*parts, None)
        found = module.deformed(points, (dx, dq), shade, PINHOLE, CENTER.to(dx.dtype), 0.5, antialias)
        return found[:4]

    return of


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize(("count", "bands"), [(300, 1), (300, 4), (300, 16), (1, 4), (0, 4)])
def test_deformed_equals_twin(count, bands, antialias):
    assert_parity(seen(splat, antialias), seen(twin, antialias), moment(count, bands), 5e-5)


def test_deformed_equals_twin_for_thin_splats():
    parts = moment(300)
    parts[2] -= 3
    assert_parity(seen(splat, True), seen(twin, True), parts, 5e-5)


def test_deformed_equals_twin_without_shade():
    assert_parity(seen(splat, True, False), seen(twin, True, False), moment(200)[:-1], 5e-5)


@pytest.mark.parametrize("antialias", [False, True])
def test_deformed_equals_twin_without_offsets(antialias):
    def of(module):
        return lambda *points: module.deformed(points, None, None, PINHOLE, CENTER.to(points[0].dtype), 0.5, antialias)[
            :4
        ]

    assert_parity(of(splat), of(twin), moment(200, 9)[:6], 5e-5)


@pytest.mark.parametrize("moved", [False, True])
def test_deformed_equals_separate_kernels(moved):
    """The default implementation, which CUDA uses, calls the kernels one by one."""
    *points, dx, dq, shade = moment(300)
    arguments = points, (dx, dq) if moved else None, shade if moved else None, PINHOLE, CENTER, 0.5, True
    for a, b in zip(splat.deformed(*arguments), Backend.deform(BACKENDS["cpu"], *arguments), strict=True):
        torch.testing.assert_close(a, b)


def test_deformed_moves_and_rotates_points():
    """Offsets with an unnormalized dq rotate a long thin point by 90 degrees about z and move it to the center of the image."""
    half = torch.tensor([[2**-0.5, 0, 0, 2**-0.5]])
    long = torch.tensor([[0.5, 0.01, 0.01]]).log()
    none = torch.zeros(1)
    points = [
        torch.tensor([[0.0, -1, 0]]),
        torch.tensor([[1.0, 0, 0, 0]]),
        long,
        none,
        torch.zeros(1, 1, 3),
        torch.zeros(1, 0, 3),
    ]
    K = torch.tensor([[50.0, 0, 20], [0, 50, 20], [0, 0, 1]])
    pose = torch.eye(4)
    pose[2, 3] = 5
    offsets, shade = (torch.tensor([[0.0, 1, 0]]), 7 * half), torch.tensor([[1.0, 0, -1, 2]])
    means2d, conics, colors, opacities, depths, radii = splat.deformed(
        points, offsets, shade, (pose, K, 40, 40), -5 * pose[2, :3], 0.1
    )
    assert means2d.tolist() == [[20, 20]]
    assert depths.tolist() == [5]
    assert radii[0] > 0
    assert float(1 / conics[0, 2]) == pytest.approx(5**2 + 0.3, rel=1e-4), "it stands upright"
    assert float(1 / conics[0, 0]) == pytest.approx(0.1**2 + 0.3, rel=1e-4)
    torch.testing.assert_close(colors, torch.tensor([[0.5 + 0.28209479, 0.5, 0.5 - 0.28209479]]))
    torch.testing.assert_close(opacities, torch.tensor([2.0]).sigmoid())


@pytest.mark.parametrize(("index", "name"), [(0, "means"), (1, "quats"), (2, "log_scales"), (6, "dx"), (7, "dq")])
def test_deformed_rejects_nan(index, name):
    parts = moment(5)
    parts[index][3, 1] = float("nan")
    *points, dx, dq, shade = parts
    with pytest.raises(GaussiansError, match=f"{name} holds 1 value"):
        splat.deformed(points, (dx, dq), shade, PINHOLE, CENTER, 0.5)
