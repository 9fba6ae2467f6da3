"""Reader of the `params.npz` of Dynamic 3D Gaussians: the same points in every frame, moving and rotating."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.errors import GaussiansError
from splatreel.scene import rotations
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.remarks import Remarks
from splatreel.scene.untrusted import read_arrays
from splatreel.sequence.plausible import check_plausible

SHAPES = {
    "means3D": ("T", "N", 3),
    "rgb_colors": ("T", "N", 3),
    "unnorm_rotations": ("T", "N", 4),
    "logit_opacities": ("N", 1),
    "log_scales": ("N", 3),
}
"""Arrays that are read. Other entries describe the training."""


class Dynamic3DGS:
    """Sequence in a `params.npz` file. Colors do not depend on the view.

    Raises:
        GaussiansError: The file is not a `params.npz` of Dynamic 3D Gaussians.
    """

    def __init__(self, path: Path) -> None:
        arrays = read_arrays(path, SHAPES, GaussiansError)
        self.path, self.size = path, path.stat().st_size
        self.fps: float | None = None
        self.remarks = Remarks()
        self._arrays = {name: _as_float(array, name == "means3D") for name, array in arrays.items()}
        self._check()

    def __len__(self) -> int:
        return len(self._arrays["means3D"])

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Return the Gaussians of a frame."""
        arrays = self._arrays
        found = Gaussians(
            means=arrays["means3D"][frame] - (0.0 if origin is None else origin),
            quats=rotations.normalize(arrays["unnorm_rotations"][frame]),
            scales=np.exp(np.minimum(arrays["log_scales"], 80)),
            opacities=1 / (1 + np.exp(-np.clip(arrays["logit_opacities"][:, 0], -80, 80))),
            sh=((arrays["rgb_colors"][frame] - 0.5) / C0)[:, None],
        )
        what = f"{self.path}, frame {frame}"
        found.check_finite(what)
        return check_plausible(found, what)

    def _check(self) -> None:
        means = self._arrays["means3D"]
        sizes = dict(zip("TN", means.shape, strict=False))
        for name, shape in SHAPES.items():
            wanted = tuple(sizes.get(size, -1) if isinstance(size, str) else size for size in shape)
            if self._arrays[name].shape != wanted or not all(wanted):
                raise GaussiansError(f"{self.path}: {name} has shape {self._arrays[name].shape}, expected {shape}.")


def _as_float(array: np.ndarray, exact: bool) -> np.ndarray:
    """Convert an array to float32; with `exact`, float64 positions stay float64."""
    return array if exact and array.dtype == np.float64 else array.astype(np.float32)
