"""Sums of images over splats, compared with the gradient to the splats' colors."""

import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.kernels import twin
from splatreel.kernels.backend import Backend
from splatreel.kernels.cpu_backend import CpuBackend
from splatreel.kernels.splat import Projection, Splats
from splatreel.kernels.splat import gather
from tests.kernels.compare import assert_close, splats


def projected(splats: Splats) -> Projection:
    return Projection(splats.means2d, splats.conics, splats.depths, splats.radii)


@pytest.mark.parametrize("channels", [1, 2, 12, 13, 36])
@pytest.mark.parametrize(
    ("width", "height", "opacity"), [(37, 29, None), (16, 32, 0.9999), (1, 1, None), (5, 50, None)]
)
def test_gather_equals_gradient_to_colors(channels: int, width: int, height: int, opacity: float | None) -> None:
    found = splats(300, 3, width, height, seed=channels)
    projection, opacities = projected(found), found.opacities
    if opacity is not None:  # pixels are full long before the last splat
        opacities = torch.full_like(opacities, opacity)
    images = torch.randn(height, width, channels, generator=torch.Generator().manual_seed(0))
    colors = torch.zeros(300, channels, dtype=torch.float64, requires_grad=True)
    means2d, conics, depths, radii = projection
    doubles = Splats(means2d.double(), conics.double(), colors, opacities.double(), depths, radii)
    twin.rasterize(doubles, width, height)[0].backward(images.double())
    assert colors.grad is not None
    arguments = projection, opacities, images
    assert_close(gather(*arguments), colors.grad, 3e-5, "the sums")
    assert_close(Backend.gather(CpuBackend(), *arguments), colors.grad, 3e-5, "the sums of other backends")


def test_gather_without_splats_or_channels() -> None:
    found, images = splats(20, 3, 10, 10), torch.ones(10, 10, 2)
    assert gather(projected(found), found.opacities, images[..., :0]).shape == (20, 0)
    nothing = found.rows(torch.zeros(0, dtype=torch.int64))
    assert gather(projected(nothing), nothing.opacities, images).shape == (0, 2)


def test_gather_refuses_nan() -> None:
    found = splats(20, 3, 10, 10)
    found.means2d[3, 0] = torch.nan
    with pytest.raises(GaussiansError, match="means2d holds 1"):
        gather(projected(found), found.opacities, torch.ones(10, 10, 2))
