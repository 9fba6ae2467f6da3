"""Trainable Gaussians: unconstrained arrays, their optimizer, and operations that change the rows of both."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from splatreel.kernels import splat
from splatreel.kernels.adam import Step
from splatreel.method.deform.knot_adam import Adam, Restore, merge_snapshots
from splatreel.scene.gaussians import Gaussians

NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh_base", "sh_rest")


class TrainablePoints:
    """Gaussians as unconstrained arrays, each with an Adam optimizer.

    Learning rates are per attribute. The rate of `means` is in world units.

    Attributes:
        origins: [N] int32, where a device has the optimizers' moments: the row of each point there, -1 for points added since. None if
            the moments are here.
    """

    def __init__(self, params: Mapping[str, np.ndarray], rates: Mapping[str, float]) -> None:
        """Copy unconstrained arrays by name, see `params`, with their learning rates."""
        self.base_rates = dict(rates)
        self.adams = {name: Adam(params[name], rates[name], eps=1e-15) for name in NAMES}
        self.origins: np.ndarray | None = None

    @staticmethod
    def from_gaussians(gaussians: Gaussians, rates: Mapping[str, float]) -> TrainablePoints:
        """Create trainable points from plain Gaussians."""
        return TrainablePoints(to_params(gaussians), rates)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.means)

    @property
    def params(self) -> dict[str, np.ndarray]:
        """Means [N, 3], quats [N, 4], log_scales [N, 3], logit_opacities [N], sh_base [N, 1, 3] and sh_rest [N, K - 1, 3] by name."""
        return {name: adam.parameter for name, adam in self.adams.items()}

    @property
    def means(self) -> np.ndarray:
        """Positions [N, 3]."""
        return self.adams["means"].parameter

    @property
    def quats(self) -> np.ndarray:
        """Rotations [N, 4], not normalized."""
        return self.adams["quats"].parameter

    @property
    def scales(self) -> np.ndarray:
        """Standard deviations [N, 3]."""
        return np.exp(self.adams["log_scales"].parameter)

    @property
    def opacities(self) -> np.ndarray:
        """Opacities [N], 0..1."""
        return sigmoid(self.adams["logit_opacities"].parameter)

    @property
    def sh(self) -> tuple[np.ndarray, np.ndarray]:
        """Constant part of the color [N, 1, 3], and its higher bands [N, K - 1, 3]."""
        return self.adams["sh_base"].parameter, self.adams["sh_rest"].parameter

    def scale_rates(self, factors: Mapping[str, float], default: float = 1.0) -> None:
        """Set every learning rate to its base rate times a factor."""
        for name, adam in self.adams.items():
            adam.rate = self.base_rates[name] * factors.get(name, default)

    def follow(self, gradients: Sequence[np.ndarray]) -> list[Step]:
        """Return the optimizer steps for gradients to all arrays, in the order of `NAMES`."""
        return [adam.follow(gradient) for adam, gradient in zip(self.adams.values(), gradients, strict=True)]

    def keep(self, index: np.ndarray) -> None:
        """Keep the rows of an index or mask, in its order, with their optimizer state."""
        for adam in self.adams.values():
            adam.rewrite(lambda rows: rows[index], lambda rows: rows[index])
        if self.origins is not None:
            self.origins = self.origins[index]

    def append(self, params: Mapping[str, np.ndarray]) -> None:
        """Add rows. Their optimizer state starts at zero."""
        for name, adam in self.adams.items():
            new = params[name]
            zeros = np.zeros_like(new)
            adam.rewrite(
                lambda rows, new=new: np.concatenate([rows, new]),
                lambda rows, zeros=zeros: np.concatenate([rows, zeros]),
            )
        if self.origins is not None:
            self.origins = np.concatenate([self.origins, np.full(len(params["means"]), -1, np.int32)])

    def rows(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Return copies of the rows of an index or mask."""
        return {name: array[index] for name, array in self.params.items()}

    def snapshot(self) -> Restore:
        """Copy all rows with their optimizer state."""
        assert self.origins is None, "the moments are on a device"
        restore_rows = merge_snapshots([adam.snapshot() for adam in self.adams.values()])

        def restore() -> None:
            restore_rows()
            self.origins = None

        return restore

    def check(self) -> None:
        """Raise a `GaussiansError` if a value is NaN or infinite."""
        splat.check_finite(**self.params)

    def gaussians(self) -> Gaussians:
        """Return the points as plain Gaussians."""
        self.check()
        return to_gaussians(self.params)


def to_params(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Convert plain Gaussians to unconstrained arrays."""
    opacities = np.clip(gaussians.opacities, 1e-4, 1 - 1e-4)
    arrays = {
        "means": gaussians.means,
        "quats": gaussians.quats,
        "log_scales": np.log(np.maximum(gaussians.scales, 1e-9)),
        "logit_opacities": np.log(opacities / (1 - opacities)),
        "sh_base": gaussians.sh[:, :1],
        "sh_rest": gaussians.sh[:, 1:],
    }
    return {name: np.array(value, np.float32, order="C") for name, value in arrays.items()}


def to_gaussians(params: Mapping[str, np.ndarray]) -> Gaussians:
    """Convert unconstrained arrays to plain Gaussians, which share no memory with them."""
    return Gaussians(
        params["means"].copy(),
        normalize(params["quats"]),
        np.exp(params["log_scales"]),
        sigmoid(params["logit_opacities"]),
        np.concatenate([params["sh_base"], params["sh_rest"]], 1),
    )


def default_rates(unit: float, pace: float = 1.0) -> dict[str, float]:
    """Return the learning rates of 3DGS times a pace.

    The higher SH bands keep their rate. At a higher rate they overfit the training cameras. The rate of positions is
    relative to `unit`, the typical viewing distance.
    """
    return {
        "means": pace * 2.2e-4 * unit,
        "quats": pace * 2e-3,
        "log_scales": pace * 7e-3,
        "logit_opacities": pace * 3e-2,
        "sh_base": pace * 4e-3,
        "sh_rest": 2e-4,
    }


def children(points: TrainablePoints, split: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return two children of every split point, sampled from the parent's Gaussian and 1.6 times smaller (3DGS section 5.2)."""
    twice = {name: np.concatenate([value, value]) for name, value in points.rows(split).items()}
    offset = rng.standard_normal(twice["means"].shape, np.float32) * np.exp(twice["log_scales"])
    twice["means"] = twice["means"] + rotate(normalize(twice["quats"]), offset)
    twice["log_scales"] = twice["log_scales"] - math.log(1.6)
    return twice


LONG_AXIS_OFFSET, LONG_AXIS_SCALE, OTHER_SCALE, HALF_OPACITY = 0.5, 0.5, 0.85, 0.6
"""Halves of a point: their distance from its center and their size along its longest axis, and their size along the others, in its
standard deviations; and their opacity, as a share of its opacity."""


def halves(points: TrainablePoints, split: np.ndarray) -> dict[str, np.ndarray]:
    """Return two halves of every split point, side by side on its longest axis. They draw nearly what the point draws.

    Source: Deng et al. 2025, "Improving Densification in 3D Gaussian Splatting for High-Fidelity Rendering", long-axis split.
    """
    rows = points.rows(split)
    axis = np.eye(3, dtype=np.float32)[rows["log_scales"].argmax(1)]
    offset = rotate(normalize(rows["quats"]), LONG_AXIS_OFFSET * axis * np.exp(rows["log_scales"]))
    twice = {name: np.concatenate([value, value]) for name, value in rows.items()}
    twice["means"] = np.concatenate([rows["means"] + offset, rows["means"] - offset])
    smaller = axis * math.log(LONG_AXIS_SCALE) + (1 - axis) * math.log(OTHER_SCALE)
    twice["log_scales"] = twice["log_scales"] + np.tile(smaller, (2, 1))
    opacities = HALF_OPACITY * sigmoid(twice["logit_opacities"])
    twice["logit_opacities"] = np.log(opacities / (1 - opacities))
    return twice


def sigmoid(logits: np.ndarray) -> np.ndarray:
    """Return 1 / (1 + exp(-logits))."""
    return 1 / (1 + np.exp(np.minimum(-logits, 80)))


def normalize(quats: np.ndarray) -> np.ndarray:
    """Return quaternions [N, 4] of length 1."""
    return quats / np.maximum(np.sqrt(np.square(quats).sum(1, keepdims=True)), 1e-12)


def rotate(quats: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Rotate vectors [N, 3] by unit quaternions [N, 4]."""
    w, xyz = quats[:, :1], quats[:, 1:]
    cross = 2 * np.cross(xyz, vectors)
    return vectors + w * cross + np.cross(xyz, cross)
