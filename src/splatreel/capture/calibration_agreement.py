"""Whether calibrations of one rig at several moments agree on where its cameras stand and what their lenses do.

Each is known up to a motion and a scale. A calibration that has too little to go by is not a little off: it is another one each time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FIELD = 5.0, 170.0
"""Degrees that a lens shows, along the longer side: beyond are no lenses of video cameras."""
TURNED, MOVED, ZOOMED = 2.0, 0.1, 0.1
"""How far calibrations may differ: degrees, shares of the cameras' distance from each other, shares of the focal length."""
FEWEST = 3
"""Cameras that two calibrations must share to be compared."""


@dataclass(frozen=True)
class CalibratedCamera:
    """One camera of a calibration.

    rotation: [3, 3] world to camera. center: [3]. focal: in lengths of the longer side. points: how many it sees.
    """

    rotation: np.ndarray
    center: np.ndarray
    focal: float
    points: int

    @property
    def field(self) -> float:
        """Degrees that it shows along the longer side."""
        return float(np.degrees(2 * np.arctan(0.5 / self.focal))) if self.focal > 0 else 180.0

    @property
    def possible(self) -> bool:
        """Whether a lens can be so."""
        return FIELD[0] <= self.field <= FIELD[1]


CalibratedRig = dict[str, CalibratedCamera]


def agreeing(one: CalibratedRig, other: CalibratedRig) -> set[str]:
    """The cameras on which two calibrations agree."""
    names = sorted(set(one) & set(other))
    if len(names) < FEWEST:
        return set()
    rotations, theirs = (np.stack([rig[name].rotation for name in names]) for rig in (one, other))
    turns = np.swapaxes(rotations, 1, 2) @ theirs  # each camera's idea of how the worlds are turned
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
    fits = (turned < TURNED) & (moved < MOVED) & (zoomed < ZOOMED)
    return {name for name, fit in zip(names, fits, strict=True) if fit}


def trusted(rigs: list[CalibratedRig], few: int) -> tuple[int, set[str]]:
    """Which calibration is the best, and its cameras that can be trusted: with possible lenses, and where another one says, too.

    A camera that sees fewer than `few` points must come out alike in all of them: what little it sees may be taken wrongly twice. Of a
    single moment there is nothing to compare with: every camera must see as many then.
    """
    found: list[set[str]] = []
    for number, rig in enumerate(rigs):
        alike = [agreeing(rig, other) for n, other in enumerate(rigs) if n != number]
        found.append({name for name, placed in rig.items() if _believed(name, placed, alike, few)})
    best = max(range(len(rigs)), key=lambda n: (len(found[n]), sum(rigs[n][name].points for name in found[n])))
    return best, found[best]


def _believed(name: str, placed: CalibratedCamera, alike: list[set[str]], few: int) -> bool:
    """alike: the cameras that come out alike, by other calibrations."""
    agreed = [name in names for names in alike]
    if placed.points < few:
        return placed.possible and len(agreed) > 0 and all(agreed)
    return placed.possible and (not agreed or any(agreed))


def _degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between rotations [N, 3, 3]."""
    trace = np.einsum("nij,nij->n", a, b)
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def _gaps(centers: np.ndarray) -> np.ndarray:
    """Distances of all pairs of places [N, 3]."""
    i, j = np.triu_indices(len(centers), 1)
    return np.linalg.norm(centers[i] - centers[j], axis=1)
