"""Models of other methods whose points move: Dynamic 3D Gaussians and SpacetimeGaussians."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, points_memory
from splatreel.base.ply_table import Columns, read_elements
from splatreel.base.untrusted import ArrayRows, read_arrays, read_file
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
    """Sequence in the `params.npz` of Dynamic 3D Gaussians: the same points in every frame, moving and rotating.

    Colors do not depend on the view. One frame is in memory at a time.

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


FAINT = 1 / 255
"""Points below this opacity are not drawn and are left out."""
MOST_FRAMES = 1_000_000
_DURATION = re.compile(rb"\bduration=([0-9]{1,7})\b")
_MOST_SETTINGS = 1 << 20


def is_spacetime(path: Path, budget: MemoryBudget = UNRAISED) -> bool:
    """Return whether a PLY file holds a model of SpacetimeGaussians. `budget` limits the memory that reading takes."""
    return path.suffix.lower() == ".ply" and "trbf_center" in _columns(path, budget)


class SpacetimeGaussians:
    """Sequence of the frames of a model (lite): points with polynomial motion, and opacities that rise and fade.

    Times run from 0 to 1, as in its training.

    Args:
        path: The model's PLY file.
        length: Number of frames that it was trained on; None takes it from the cfg_args of its training.
        budget: Memory that reading may take.

    Raises:
        GaussiansError: The model is not of the lite kind, or the number of frames is unknown.

    Source:
        Spacetime Gaussian Feature Splatting, section 4.1.
    """

    antialias = False

    def __init__(self, path: Path, length: int | None, budget: MemoryBudget = UNRAISED) -> None:
        self.path = path
        self.size = path.stat().st_size
        self.fps: float | None = None
        self.remarks = Remarks()
        columns = _columns(path, budget)
        _check_lite(columns, path)
        self._length = length or _trained_length(path)
        self._place = _stack(columns, "x", "y", "z")
        self._motion = _stack(columns, *(f"motion_{i}" for i in range(9))).reshape(-1, 3, 3)
        self._turn = _stack(columns, *(f"rot_{i}" for i in range(4)))
        self._spin = _stack(columns, *(f"omega_{i}" for i in range(4)))
        self._scales = np.exp(np.minimum(_stack(columns, "scale_0", "scale_1", "scale_2"), 80)).astype(np.float32)
        self._opacity = 1 / (1 + np.exp(-np.clip(_stack(columns, "opacity")[:, 0], -80, 80)))
        self._center = _stack(columns, "trbf_center")[:, 0]
        self._width = np.exp(np.clip(_stack(columns, "trbf_scale")[:, 0], -80, 80))
        color = _stack(columns, "f_dc_0", "f_dc_1", "f_dc_2")
        self._sh = ((color - 0.5) / C0)[:, None].astype(np.float32)

    def __len__(self) -> int:
        return self._length

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Return the Gaussians of a frame."""
        since = frame / self._length - self._center
        opacities = self._opacity * np.exp(-np.square(since / self._width))
        some = ~(opacities < FAINT)
        powers = np.stack([since, since**2, since**3], 1)[some]
        means = self._place[some] + np.einsum("np,npc->nc", powers, self._motion[some])
        points = Gaussians(
            means=means - (0.0 if origin is None else origin),
            quats=rotations.normalize(self._turn[some] + since[some, None] * self._spin[some]),
            scales=self._scales[some],
            opacities=opacities[some],
            sh=self._sh[some],
        )
        return check_plausible(drop_nan(points, str(self.path), self.remarks), f"{self.path}, frame {frame}")


def _columns(path: Path, budget: MemoryBudget) -> Columns:
    return read_elements(path, ("vertex",), budget).get("vertex", {})


def _stack(columns: Columns, *names: str) -> np.ndarray:
    return np.stack([np.asarray(columns[name], np.float64) for name in names], 1)


def _check_lite(columns: Columns, path: Path) -> None:
    if "f_dc_3" in columns or any(name.startswith("f_t") for name in columns):
        raise GaussiansError(
            f"{path}: is a full model of SpacetimeGaussians, whose colors a network computes for each pixel. Train its lite model "
            "(ours_lite), which stores colors."
        )
    names = ["x", "y", "z", "trbf_center", "trbf_scale", "opacity", *(f"motion_{i}" for i in range(9))]
    names += [
        f"{part}_{i}" for part, count in (("f_dc", 3), ("scale", 3), ("rot", 4), ("omega", 4)) for i in range(count)
    ]
    missing = [name for name in names if name not in columns]
    if missing:
        raise GaussiansError(f"{path}: is not a model of SpacetimeGaussians: missing {', '.join(missing[:4])}.")


def _trained_length(path: Path) -> int:
    for folder in list(path.resolve().parents)[:4]:
        file = folder / "cfg_args"
        found = _DURATION.search(read_file(file, _MOST_SETTINGS, GaussiansError)) if file.is_file() else None
        if found and 1 <= int(found[1]) <= MOST_FRAMES:
            return int(found[1])
    raise GaussiansError(
        f"{path}: is a model of SpacetimeGaussians without its cfg_args, which states the number of frames. Give it with --length, "
        "often 50."
    )
