"""A set of 3D Gaussians as numpy arrays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from splatreel.base.command_line import needing_packages
from splatreel.base.errors import GaussiansError
from splatreel.scene import rotations

if TYPE_CHECKING:
    import torch

C0 = 0.28209479177387814
"""Constant of spherical harmonic degree 0."""


@dataclass(frozen=True, repr=False)
class Gaussians:
    """Gaussians in world space, activated (no logarithms or logits), all float32.

    Attributes:
        means: Positions, [N, 3], world units.
        quats: Rotations, [N, 4] wxyz, unit.
        scales: Standard deviations, [N, 3], world units.
        opacities: [N], 0..1.
        sh: Spherical harmonics, [N, (degree + 1)^2, 3], in the 3DGS order. sh[:, 0] is the DC term (c_base), the rest
            c_rest.
        near: Smallest depth at which training drew them, world units; None if it is not known. `splatreel.render` draws nothing nearer.
            Files of Gaussians do not store it.
    """

    ARRAYS: ClassVar[tuple[str, ...]] = ("means", "quats", "scales", "opacities", "sh")

    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    sh: np.ndarray
    near: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        for name in self.ARRAYS:
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), np.float32))
        n = len(self.means)
        bands = self.sh.shape[1] if self.sh.ndim == 3 else -1
        expected = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,), "sh": (n, bands, 3)}
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise GaussiansError(f"Gaussians: {name} has shape {getattr(self, name).shape}, expected {shape}.")
        if bands not in (1, 4, 9, 16):
            raise GaussiansError(f"Gaussians: sh has {bands} coefficients a channel, expected 1, 4, 9 or 16.")

    def __len__(self) -> int:
        return len(self.means)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self):,} points, SH degree {self.sh_degree})"

    def __getitem__(self, index: np.ndarray | slice) -> Gaussians:
        """Select Gaussians by an index array, a mask or a slice."""
        return Gaussians(*(getattr(self, name)[index] for name in self.ARRAYS), near=self.near)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0..3."""
        return round(self.sh.shape[1] ** 0.5) - 1

    @property
    def base_colors(self) -> np.ndarray:
        """Colors without their view-dependent part, [N, 3] float32, about 0..1 but not limited to it."""
        return 0.5 + C0 * self.sh[:, 0]

    def to_torch(self, device: str | torch.device = "cpu") -> dict[str, torch.Tensor]:
        """Return the arrays by name as float32 tensors, which gsplat's `rasterization` takes as they are.

        Args:
            device: Device of the tensors, such as cuda.

        Raises:
            MissingDependencyError: PyTorch is not installed.
        """
        with needing_packages():
            import torch
        return {name: torch.tensor(getattr(self, name), device=device) for name in self.ARRAYS}

    def check_finite(self, what: str = "Gaussians") -> None:
        """Raise `GaussiansError` if a value is NaN or infinite."""
        for name in self.ARRAYS:
            bad = ~np.isfinite(getattr(self, name))
            if bad.any():
                raise GaussiansError(f"{what}: {name} holds {int(bad.sum())} values that are NaN or infinite.")

    def moved(self, dx: np.ndarray, dq: np.ndarray) -> Gaussians:
        """Return the Gaussians deformed by offsets: x + dx, q * dq.

        Args:
            dx: Position offsets, [N, 3], world units.
            dq: Rotation offsets, [N, 4] wxyz, of any length.

        Source:
            Paper, section 4.2.
        """
        quats = rotations.multiply(self.quats, rotations.normalize(dq))
        return Gaussians(self.means + dx, quats, self.scales, self.opacities, self.sh, near=self.near)

    def shaded(self, shade: np.ndarray) -> Gaussians:
        """Return the Gaussians with `shade` [N, 4] added to c_base and opacity; opacities are clamped to 0..1."""
        sh = self.sh.copy()
        sh[:, 0] += shade[:, :3]
        opacities = np.clip(self.opacities + shade[:, 3], 0, 1)
        return Gaussians(self.means, self.quats, self.scales, opacities, sh, near=self.near)

    def brightened(self, factor: np.ndarray) -> Gaussians:
        """Return the Gaussians with every color, from any direction, multiplied by `factor` [3]."""
        sh = self.sh * factor
        sh[:, 0] += (factor - 1) * np.float32(0.5 / C0)  # a color is 0.5 plus the harmonics
        return Gaussians(self.means, self.quats, self.scales, self.opacities, sh, near=self.near)

    def faded(self, weight: float | np.ndarray) -> Gaussians:
        """Return the Gaussians faded by `weight` 0..1 in optical depth: opacity becomes 1 - (1 - opacity)^weight.

        Two coinciding sets faded by w and 1 - w absorb as much light as one set. A linear fade absorbs more.
        """
        opacities = 1 - (1 - np.minimum(self.opacities, 0.9999)) ** np.asarray(weight, np.float32)
        return Gaussians(self.means, self.quats, self.scales, opacities, self.sh, near=self.near)

    def at_degree(self, degree: int) -> Gaussians:
        """Return the Gaussians with spherical harmonics of another degree: higher bands are cut off, or zero."""
        bands = (degree + 1) ** 2
        sh = np.pad(self.sh[:, :bands], ((0, 0), (0, max(bands - self.sh.shape[1], 0)), (0, 0)))
        return Gaussians(self.means, self.quats, self.scales, self.opacities, sh, near=self.near)

    @staticmethod
    def empty(sh_degree: int = 3) -> Gaussians:
        """Return zero Gaussians."""
        return Gaussians(
            np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, (sh_degree + 1) ** 2, 3))
        )

    @staticmethod
    def concatenate(parts: list[Gaussians]) -> Gaussians:
        """Concatenate sets of Gaussians in order, padding lower SH degrees with zeros. The result has the farthest near plane."""
        bands = max(p.sh.shape[1] for p in parts)
        padded = [np.pad(p.sh, ((0, 0), (0, bands - p.sh.shape[1]), (0, 0))) for p in parts]
        names = ("means", "quats", "scales", "opacities")
        means, quats, scales, opacities = (np.concatenate([getattr(p, n) for p in parts]) for n in names)
        near = max((p.near for p in parts if p.near is not None), default=None)
        return Gaussians(means, quats, scales, opacities, np.concatenate(padded), near=near)


@dataclass(frozen=True)
class StaticPoints:
    """All static Gaussians so far and their alive flags.

    Gaussians are never removed, because a reel stores a flag for each of them. Every change returns a new object.

    Attributes:
        points: All S Gaussians that became static in some group, decoded, in reel order.
        alive: Gaussians that are static now, [S] bool.
    """

    points: Gaussians
    alive: np.ndarray

    @staticmethod
    def none(sh_degree: int = 3) -> StaticPoints:
        """Return an object without Gaussians."""
        return StaticPoints(Gaussians.empty(sh_degree), np.zeros(0, bool))

    @cached_property
    def living(self) -> Gaussians:
        """The A Gaussians that are static now."""
        return self.points[self.alive]

    def without(self, gone: np.ndarray) -> StaticPoints:
        """Return the object with some living Gaussians, `gone` [A] bool, no longer alive."""
        alive = self.alive.copy()
        alive[self.alive] = ~gone
        return self.with_alive(alive)

    def with_alive(self, alive: np.ndarray) -> StaticPoints:
        """Return the object with other alive flags, [S] bool."""
        return replace(self, alive=alive)

    def with_layer(self, decoded: Gaussians) -> StaticPoints:
        """Return the object with a decoded layer appended, all of it alive."""
        points = Gaussians.concatenate([self.points, decoded])
        return StaticPoints(points, np.concatenate([self.alive, np.ones(len(decoded), bool)]))


_SAMPLES = 64
"""Directions that determine the rotation of harmonics."""


def turn_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the smallest rotation, [4] wxyz, that takes one direction [3] to another.

    Opposite directions are half a turn apart about x, or about y if they are along x.
    """
    a, b = (np.asarray(v, np.float64) / np.linalg.norm(v) for v in (start, end))
    if a @ b < -0.999999:
        across = np.eye(3)[0 if abs(a[0]) < 0.9 else 1]
        across -= (across @ a) * a
        return np.concatenate([[0.0], across / np.linalg.norm(across)])
    quat = np.concatenate([[1 + a @ b], np.cross(a, b)])
    return quat / np.linalg.norm(quat)


def turn_upright(up: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the rotation, [4] wxyz, that takes an up direction [3] to an axis [3].

    The direction first turns to the nearest axis, then from axis to axis. So scenes that are slightly tilted keep the same
    side in front, whatever axis is up.
    """
    nearest = np.zeros(3)
    nearest[np.abs(up).argmax()] = np.sign(up[np.abs(up).argmax()])
    return rotations.multiply(turn_between(nearest, end), turn_between(up, nearest))


def turned(points: Gaussians, quat: np.ndarray) -> Gaussians:
    """Return Gaussians rotated about the origin by a unit quaternion [4] wxyz, with their view-dependent colors."""
    quat = np.asarray(quat, np.float64)
    if abs(quat[0]) == 1:
        return points
    matrix = rotations.to_matrix(quat)
    quats = rotations.multiply(np.broadcast_to(quat, points.quats.shape), points.quats)
    sh = points.sh.copy()
    for degree in range(1, points.sh_degree + 1):
        band = slice(degree**2, (degree + 1) ** 2)
        sh[:, band] = np.einsum("ij,njc->nic", _turn_of_band(matrix, degree), points.sh[:, band])
    return Gaussians(points.means @ matrix.T, quats, points.scales, points.opacities, sh)


def _turn_of_band(matrix: np.ndarray, degree: int) -> np.ndarray:
    """Return the matrix that rotates the coefficients of a degree, found from the values in many directions."""
    directions = np.random.default_rng(0).normal(size=(_SAMPLES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found, *_ = np.linalg.lstsq(_band(directions, degree), _band(directions @ matrix, degree))
    return np.where(np.abs(found) < 1e-9, 0, found)


def _band(directions: np.ndarray, degree: int) -> np.ndarray:
    """Return the harmonics of degree 1 to 3 in unit directions [D, 3], [D, 2 * degree + 1], up to common factors."""
    x, y, z = directions.T
    if degree == 1:
        return np.stack([-y, z, -x], 1)
    if degree == 2:
        root = np.sqrt(3)
        across = [x * y, -y * z, (2 * z * z - x * x - y * y) / (2 * root), -x * z, (x * x - y * y) / 2]
        return np.stack(across, 1)
    return np.stack(
        [
            -np.sqrt(10) * y * (3 * x * x - y * y),
            np.sqrt(240) * x * y * z,
            -np.sqrt(6) * y * (4 * z * z - x * x - y * y),
            2 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -np.sqrt(6) * x * (4 * z * z - x * x - y * y),
            np.sqrt(60) * z * (x * x - y * y),
            -np.sqrt(10) * x * (x * x - 3 * y * y),
        ],
        1,
    )
