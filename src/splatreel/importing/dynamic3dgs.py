"""Reader of the `params.npz` of Dynamic 3D Gaussians: the same points in every frame, moving and rotating."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, points_memory
from splatreel.base.untrusted import ArrayRows, read_arrays
from splatreel.formats.splat_columns import Remarks, check_plausible, drop_nan
from splatreel.scene import rotations
from splatreel.scene.gaussians import C0, Gaussians

SHAPES = {
    "means3D": ("T", "N", 3),
    "rgb_colors": ("T", "N", 3),
    "unnorm_rotations": ("T", "N", 4),
    "logit_opacities": ("N", 1),
    "log_scales": ("N", 3),
}
"""Arrays that are read, of T frames and N points. Other entries describe the training."""
CONSTANT = ("rgb_colors", "unnorm_rotations")
"""Arrays that may lack the frames, as methods write that keep colors or rotations constant."""
ROUND = ("N", 1)
"""Shape of `log_scales` for spheres, which have one size for all axes."""


class Dynamic3DGS:
    """Sequence in a `params.npz` file. Colors do not depend on the view. One frame is in memory at a time.

    Args:
        path: Input file.
        budget: Memory that reading a frame may take.

    Raises:
        GaussiansError: The file is not a `params.npz` of Dynamic 3D Gaussians, or takes too much memory.
    """

    antialias = False

    def __init__(self, path: Path, budget: MemoryBudget = UNRAISED) -> None:
        self.path = path
        self.size = path.stat().st_size
        self.fps: float | None = None
        self.remarks = Remarks()
        self._rows = {name: ArrayRows(path, name, GaussiansError) for name in SHAPES}
        self._check()
        points = self._rows["means3D"].shape[1]
        budget.check(points_memory(points), self.size, str(path), f"{points:,} points")
        still = [name for name in CONSTANT if len(self._rows[name].shape) == 2]
        names = ("logit_opacities", "log_scales", *still)
        fixed = read_arrays(path, names, GaussiansError, budget.limit(self.size))
        self._constant = {name: fixed[name] for name in still}
        logits, logarithms = fixed["logit_opacities"][:, 0], fixed["log_scales"]
        self._opacities = 1 / (1 + np.exp(-np.clip(logits.astype(np.float64), -80, 80)))
        scales = np.exp(np.minimum(logarithms.astype(np.float64), 80)).astype(np.float32)
        self._scales = np.broadcast_to(scales.reshape(len(scales), -1), (len(scales), 3))

    def __len__(self) -> int:
        return len(self._rows["means3D"])

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Return the Gaussians of a frame."""
        rows = {name: self._rows[name][frame] for name in ("means3D", *CONSTANT) if name not in self._constant}
        rows = {name: row.astype(np.float64) for name, row in (rows | self._constant).items()}
        found = Gaussians(
            means=rows["means3D"] - (0.0 if origin is None else origin),
            quats=rotations.normalize(rows["unnorm_rotations"]),
            scales=self._scales,
            opacities=self._opacities,
            sh=((rows["rgb_colors"] - 0.5) / C0)[:, None],
        )
        what = f"{self.path}, frame {frame}"
        return check_plausible(drop_nan(found, what, self.remarks), what)

    def _check(self) -> None:
        sizes = dict(zip("TN", self._rows["means3D"].shape, strict=False))
        for name, shape in SHAPES.items():
            found = self._rows[name].shape
            allowed = [shape, *([ROUND] if name == "log_scales" else []), *([shape[1:]] if name in CONSTANT else [])]
            wanted = [tuple(sizes.get(size, -1) if isinstance(size, str) else size for size in one) for one in allowed]
            if found not in wanted or not all(found):
                expected, means = " or ".join(map(_sizes, allowed)), _sizes(self._rows["means3D"].shape)
                raise GaussiansError(
                    f"{self.path}: {name} has the shape {_sizes(found)}, expected {expected} (frames T, points N; means3D: {means}). "
                    "Save it in this shape."
                )


def _sizes(shape: tuple[int | str, ...]) -> str:
    return " x ".join(map(str, shape)) or "of a single number"
