"""Gaussians of a reel as a .4dgs file, written by the package fourdgs. What stays the same is stored once."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.atomic import write_bytes
from splatreel.base.command_line import install_command
from splatreel.base.errors import GaussiansError
from splatreel.play.gaussian_export import GaussianExport
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.turning import turned

LOWEST, HIGHEST = -4.0, 4.0
"""Range of the bytes that store view-dependent color."""


def write_fourdgs(path: Path, film: GaussianExport, fps: float) -> None:
    """Write the Gaussians at all times as one .4dgs file, atomically. Its y axis is up.

    Each Gaussian has a window of time in which it is shown: as long as all its values stay the same.

    Args:
        path: Output file.
        film: The Gaussians.
        fps: Frames per second.

    Raises:
        GaussiansError: The package fourdgs is missing, or the file cannot be written.
    """
    try:
        import fourdgs  # pyright: ignore[reportMissingImports] - optional
    except ImportError as error:
        raise GaussiansError(
            f"{path}: needs the package fourdgs to be written. Run\n  {install_command('splats')}"
        ) from error
    turn = film.placement.turn
    points, begin, end = _windows(turned(points, turn) for points in film)
    packed = io.BytesIO()
    fourdgs.write(packed, _gaussian_set(fourdgs, points, begin / fps, end / fps), len(film.seconds) / fps)
    write_bytes(path, packed.getvalue())


def _windows(frames: Iterable[Gaussians]) -> tuple[Gaussians, np.ndarray, np.ndarray]:
    """Return all distinct Gaussians of frames, the first frame that shows each, and the frame after the last, [N]."""
    done: list[tuple[Gaussians, np.ndarray, int]] = []
    shown, since, keys = Gaussians.empty(), np.zeros(0, np.int64), np.zeros(0, "S1")
    count = 0
    for frame, points in enumerate(frames):
        new_keys = _keys(points)
        _, mine, theirs = np.intersect1d(new_keys, keys, return_indices=True)
        begin = np.full(len(points), frame)
        begin[mine] = since[theirs]
        gone = np.ones(len(keys), bool)
        gone[theirs] = False
        done.append((shown[gone], since[gone], frame))
        shown, since, keys, count = points, begin, new_keys, frame + 1
    done.append((shown, since, count))
    parts = [(points, begin, end) for points, begin, end in done if len(points)]
    ends = np.concatenate([np.full(len(points), end) for points, _, end in parts])
    return Gaussians.concatenate([points for points, *_ in parts]), np.concatenate([part[1] for part in parts]), ends


def _keys(points: Gaussians) -> np.ndarray:
    """Return all values of each Gaussian as one comparable key, [N]."""
    columns = (points.means, points.quats, points.scales, points.opacities, points.sh)
    table = np.concatenate([column.reshape(len(points), -1) for column in columns], 1)
    return np.ascontiguousarray(table).view(f"S{table.shape[1] * 4}").ravel()


def _gaussian_set(fourdgs: Any, points: Gaussians, begin: np.ndarray, end: np.ndarray) -> Any:
    """Return Gaussians with windows of time, in seconds, as fourdgs has them."""
    rest = points.sh[:, 1:].transpose(0, 2, 1).reshape(len(points), -1)
    stored = np.rint(np.clip((rest - LOWEST) / (HIGHEST - LOWEST), 0, 1) * 255).astype(np.uint8)
    color = np.concatenate([np.clip(points.base_colors, 0, 1), points.opacities[:, None]], 1)
    return fourdgs.GaussianSet(
        positions=points.means,
        scales=points.scales,
        rotations=np.roll(points.quats, -1, axis=1),
        colors=color.astype(np.float32),
        motions=np.zeros_like(points.means),
        mu_t=((begin + end) / 2).astype(np.float32),
        sigma_t=np.full(len(points), np.inf, np.float32),
        win_lo=begin.astype(np.float64),
        win_hi=end.astype(np.float64),
        sh=stored if points.sh_degree else None,
        sh_degree=points.sh_degree,
    )
