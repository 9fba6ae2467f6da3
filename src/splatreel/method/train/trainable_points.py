"""Trainable Gaussians: leaf tensors, their optimizer, and operations that change the rows of both."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.method.deform.knot_adam import Adam, Restore, merge_snapshots, step
from splatreel.scene.gaussians import Gaussians

NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh_base", "sh_rest")


class TrainablePoints:
    """Gaussians as unconstrained leaf tensors, each with an Adam optimizer.

    Learning rates are per attribute. The rate of `means` is in world units.
    """

    def __init__(self, params: Mapping[str, Tensor], rates: Mapping[str, float]) -> None:
        """Copy unconstrained tensors.

        Args:
            params: Tensors by name, see `params`.
            rates: Learning rates by name.
        """
        self.base_rates = dict(rates)
        self.adams = {name: Adam(params[name], rates[name], eps=1e-15) for name in NAMES}

    @staticmethod
    def from_gaussians(gaussians: Gaussians, rates: Mapping[str, float], device: torch.device) -> TrainablePoints:
        """Create trainable points from plain Gaussians."""
        return TrainablePoints(to_params(gaussians, device), rates)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.means)

    @property
    def params(self) -> dict[str, Tensor]:
        """Unconstrained tensors by name.

        They are means [N, 3], quats [N, 4], log_scales [N, 3], logit_opacities [N], sh_base [N, 1, 3] and sh_rest [N, K - 1,
        3].
        """
        return {name: adam.tensor for name, adam in self.adams.items()}

    @property
    def means(self) -> Tensor:
        """Positions [N, 3]."""
        return self.adams["means"].tensor

    @property
    def quats(self) -> Tensor:
        """Rotations [N, 4], not normalized."""
        return self.adams["quats"].tensor

    @property
    def scales(self) -> Tensor:
        """Standard deviations [N, 3]."""
        return self.adams["log_scales"].tensor.exp()

    @property
    def opacities(self) -> Tensor:
        """Opacities [N], 0..1."""
        return self.adams["logit_opacities"].tensor.sigmoid()

    @property
    def sh(self) -> tuple[Tensor, Tensor]:
        """Constant part of the color [N, 1, 3], and its higher bands [N, K - 1, 3]."""
        return self.adams["sh_base"].tensor, self.adams["sh_rest"].tensor

    def scale_rates(self, factors: Mapping[str, float], default: float = 1.0) -> None:
        """Set every learning rate to its base rate times a factor."""
        for name, adam in self.adams.items():
            adam.rate = self.base_rates[name] * factors.get(name, default)

    def step(self, position_scale: Tensor | None = None) -> None:
        """Follow the gradients and clear them. position_scale: [N, 1], factor for the steps of positions."""
        before = None if position_scale is None else self.means.detach().clone()
        step(self.adams.values())
        if before is not None and position_scale is not None:
            with torch.no_grad():
                self.means.copy_(torch.lerp(before, self.means, position_scale))

    def price_sh(self, price: float) -> None:
        """Add the gradient of `price` times the L1 norm of the higher SH bands."""
        rest = self.adams["sh_rest"].tensor
        if price and rest.grad is not None:
            rest.grad.add_(rest.detach().sign(), alpha=price)

    def clear(self) -> None:
        """Clear the gradients."""
        for adam in self.adams.values():
            adam.tensor.grad = None

    def keep(self, index: Tensor) -> None:
        """Keep the rows of an index or mask, in its order, with their optimizer state."""
        for adam in self.adams.values():
            adam.rewrite(lambda rows: rows[index], lambda rows: rows[index])

    def append(self, params: Mapping[str, Tensor]) -> None:
        """Add rows. Their optimizer state starts at zero."""
        for name, adam in self.adams.items():
            new = params[name].detach()
            zeros = torch.zeros_like(new)
            adam.rewrite(
                lambda rows, new=new: torch.cat([rows, new]), lambda rows, zeros=zeros: torch.cat([rows, zeros])
            )

    def rows(self, index: Tensor) -> dict[str, Tensor]:
        """Return copies of the rows of an index or mask."""
        return {name: tensor.detach()[index].clone() for name, tensor in self.params.items()}

    def snapshot(self) -> Restore:
        """Copy all rows with their optimizer state."""
        return merge_snapshots([adam.snapshot() for adam in self.adams.values()])

    def check(self) -> None:
        """Check all values. On a GPU this is the only check, since reading a value waits for the GPU.

        Raises:
            GaussiansError: If a value is NaN or infinite.
        """
        splat.check_finite(**self.params)

    def gaussians(self) -> Gaussians:
        """Return the points as plain Gaussians."""
        self.check()
        return to_gaussians(self.params)


def to_params(gaussians: Gaussians, device: torch.device) -> dict[str, Tensor]:
    """Convert plain Gaussians to unconstrained tensors."""
    opacities = np.clip(gaussians.opacities, 1e-4, 1 - 1e-4)
    arrays = {
        "means": gaussians.means,
        "quats": gaussians.quats,
        "log_scales": np.log(np.maximum(gaussians.scales, 1e-9)),
        "logit_opacities": np.log(opacities / (1 - opacities)),
        "sh_base": gaussians.sh[:, :1],
        "sh_rest": gaussians.sh[:, 1:],
    }
    return {name: torch.from_numpy(np.array(value, np.float32)).to(device) for name, value in arrays.items()}


def to_gaussians(params: Mapping[str, Tensor]) -> Gaussians:
    """Convert unconstrained tensors to plain Gaussians."""
    p = {name: tensor.detach().cpu() for name, tensor in params.items()}
    return Gaussians(
        p["means"].numpy(),
        torch.nn.functional.normalize(p["quats"], dim=-1).numpy(),
        p["log_scales"].exp().numpy(),
        p["logit_opacities"].sigmoid().numpy(),
        torch.cat([p["sh_base"], p["sh_rest"]], 1).numpy(),
    )


def default_rates(unit: float, pace: float = 1.0) -> dict[str, float]:
    """Return the learning rates of 3DGS times a pace.

    The higher SH bands keep their rate. At a higher rate they overfit the training cameras.

    Args:
        unit: Typical viewing distance, world units. The rate of positions is relative to it.
        pace: Factor for all other rates.
    """
    return {
        "means": pace * 2.2e-4 * unit,
        "quats": pace * 2e-3,
        "log_scales": pace * 7e-3,
        "logit_opacities": pace * 3e-2,
        "sh_base": pace * 4e-3,
        "sh_rest": 2e-4,
    }


def children(points: TrainablePoints, split: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
    """Return two children of every split point, sampled from the parent's Gaussian and 1.6 times smaller (3DGS section 5.2)."""
    rows = points.rows(split)
    twice = {name: torch.cat([value, value]) for name, value in rows.items()}
    noise = torch.randn(twice["means"].shape, generator=generator).to(twice["means"].device)
    offset = noise * twice["log_scales"].exp()
    twice["means"] = twice["means"] + rotate(torch.nn.functional.normalize(twice["quats"], dim=-1), offset)
    twice["log_scales"] = twice["log_scales"] - math.log(1.6)
    return twice


LONG_AXIS_OFFSET, LONG_AXIS_SCALE, OTHER_SCALE, HALF_OPACITY = 0.5, 0.5, 0.85, 0.6
"""Halves of a point: their distance from its center and their size along its longest axis, and their size along the others, in its
standard deviations; and their opacity, as a share of its opacity."""


def halves(points: TrainablePoints, split: Tensor) -> dict[str, Tensor]:
    """Return two halves of every split point, side by side on its longest axis. They draw nearly what the point draws.

    Source: Deng et al. 2025, "Improving Densification in 3D Gaussian Splatting for High-Fidelity Rendering", long-axis split.
    """
    rows = points.rows(split)
    axis = torch.eye(3, dtype=rows["means"].dtype, device=rows["means"].device)[rows["log_scales"].argmax(1)]
    offset = LONG_AXIS_OFFSET * axis * rows["log_scales"].exp()
    offset = rotate(torch.nn.functional.normalize(rows["quats"], dim=-1), offset)
    twice = {name: torch.cat([value, value]) for name, value in rows.items()}
    twice["means"] = torch.cat([rows["means"] + offset, rows["means"] - offset])
    smaller = axis * math.log(LONG_AXIS_SCALE) + (1 - axis) * math.log(OTHER_SCALE)
    twice["log_scales"] = twice["log_scales"] + smaller.repeat(2, 1)
    twice["logit_opacities"] = torch.logit(HALF_OPACITY * torch.sigmoid(twice["logit_opacities"]))
    return twice


def rotate(quats: Tensor, vectors: Tensor) -> Tensor:
    """Rotate vectors [N, 3] by unit quaternions [N, 4]."""
    w, xyz = quats[:, :1], quats[:, 1:]
    cross = 2 * torch.linalg.cross(xyz, vectors)
    return vectors + w * cross + torch.linalg.cross(xyz, cross)
