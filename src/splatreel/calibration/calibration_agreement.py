"""Agreement of calibrations of one rig at several moments.

Each calibration is known up to a similarity transform. A calibration with too few matches is not slightly wrong but
different each time.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.calibration.calibration_files import PHOTO_FOLDER

FIELD = 5.0, 170.0
"""Plausible fields of view of video cameras along the longer side, degrees."""
TURNED, MOVED, ZOOMED = 2.0, 0.1, 0.1
"""Tolerances: degrees, share of the distance between cameras, share of the focal length."""
ONE_LENS_ZOOMED = 0.25
"""Tolerance of the focal length for cameras of one lens. An error of it moves all cameras alike, and few
cameras tell little about it."""
FEWEST = 3
"""Minimum number of shared cameras to compare two calibrations."""


@dataclass(frozen=True)
class CalibratedCamera:
    """One camera of a calibration.

    Attributes:
        rotation: World to camera, [3, 3].
        center: Optical center, [3].
        focal: Focal length in units of the longer side.
        points: Number of visible points.
    """

    rotation: np.ndarray
    center: np.ndarray
    focal: float
    points: int

    @property
    def field(self) -> float:
        """Field of view along the longer side, degrees."""
        return float(np.degrees(2 * np.arctan(0.5 / self.focal))) if self.focal > 0 else 180.0

    @property
    def possible(self) -> bool:
        """True if a lens can have this field of view."""
        return FIELD[0] <= self.field <= FIELD[1]


CalibratedRig = dict[str, CalibratedCamera]


def placed_images(model: Any) -> list[Any]:
    """Return the images of a model (pycolmap.Reconstruction) whose poses are known."""
    return [model.image(number) for number in model.reg_image_ids()]


def rig_of(model: Any) -> CalibratedRig:
    """Return the cameras of a model (pycolmap.Reconstruction), without photographs."""
    rig = {}
    for image in placed_images(model):
        if image.name.startswith(PHOTO_FOLDER):
            continue
        matrix, lens = np.asarray(image.cam_from_world().matrix()), image.camera
        focal = float(lens.calibration_matrix()[0, 0]) / max(lens.width, lens.height)
        center = -matrix[:, :3].T @ matrix[:, 3]
        rig[Path(image.name).stem] = CalibratedCamera(matrix[:, :3], center, focal, int(image.num_points3D))
    return rig


def agreeing(one: CalibratedRig, other: CalibratedRig, zoom: float = ZOOMED) -> set[str]:
    """Return the cameras on which two calibrations agree. `zoom`: tolerance of the focal length, as a share of it."""
    names = sorted(set(one) & set(other))
    if len(names) < FEWEST:
        return set()
    rotations, theirs = (np.stack([rig[name].rotation for name in names]) for rig in (one, other))
    turns = np.swapaxes(rotations, 1, 2) @ theirs  # rotation between the worlds, as estimated from each camera
    off = np.stack([_degrees(rotations @ turn, theirs) for turn in turns])
    best = int(np.median(off, 1).argmin())
    turn, turned = turns[best], off[best]
    here, there = (np.stack([rig[name].center for name in names]) for rig in (one, other))
    there = there @ turn.T
    gaps, their_gaps = _gaps(here), _gaps(there)
    scale = float(np.median(gaps) / max(np.median(their_gaps), 1e-12))
    moved = here - scale * there
    moved = np.linalg.norm(moved - np.median(moved, 0), axis=1) / max(float(np.median(gaps)), 1e-12)
    focals, their_focals = (np.array([rig[name].focal for name in names]) for rig in (one, other))
    zoomed = np.abs(focals - their_focals) / np.maximum(np.abs(their_focals), 1e-12)
    fits = (turned < TURNED) & (moved < MOVED) & (zoomed < zoom)
    return {name for name, fit in zip(names, fits, strict=True) if fit}


def unanimous(rigs: list[CalibratedRig]) -> set[str]:
    """Return the cameras on which each two calibrations agree; none for a single calibration."""
    pairs = [agreeing(rig, other) for number, rig in enumerate(rigs) for other in rigs[:number]]
    return set.intersection(*pairs) if pairs else set()


def trusted(rigs: list[CalibratedRig], few: int, zoom: float = ZOOMED) -> tuple[int, set[str]]:
    """Return the index of the best calibration and its trusted cameras: plausible lenses, confirmed by another calibration.

    A camera with fewer than `few` points must agree in all calibrations. With a single calibration every camera needs
    as many points. `zoom`: see `agreeing`.
    """
    found: list[set[str]] = []
    for number, rig in enumerate(rigs):
        alike = [agreeing(rig, other, zoom) for n, other in enumerate(rigs) if n != number]
        found.append({name for name, placed in rig.items() if _believed(name, placed, alike, few)})
    best = max(range(len(rigs)), key=lambda n: (len(found[n]), sum(rigs[n][name].points for name in found[n])))
    return best, found[best]


def _believed(name: str, placed: CalibratedCamera, alike: list[set[str]], few: int) -> bool:
    """Return whether a camera is trusted. `alike` has the agreeing cameras for each other calibration."""
    agreed = [name in names for names in alike]
    if placed.points < few:
        return placed.possible and len(agreed) > 0 and all(agreed)
    return placed.possible and (not agreed or any(agreed))


def _degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles between rotations [N, 3, 3]."""
    trace = np.einsum("nij,nij->n", a, b)
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def _gaps(centers: np.ndarray) -> np.ndarray:
    i, j = np.triu_indices(len(centers), 1)
    return np.linalg.norm(centers[i] - centers[j], axis=1)
