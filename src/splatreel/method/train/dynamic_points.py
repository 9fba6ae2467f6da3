"""Dynamic points of a group during training: canonical Gaussians, their motion and their appearance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from splatreel.config import GroupConfig
from splatreel.kernels.splat import Splats
from splatreel.method.deform.appearance import Appearance, detect_cuts
from splatreel.method.deform.hashgrid import HashGrid
from splatreel.method.deform.knot_adam import Restore, merge_snapshots
from splatreel.method.deform.protocol import Deformation
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.render import View, deformed
from splatreel.method.train.trainable_points import TrainablePoints
from splatreel.method.train.training_images import TrainingImages

MODELS = {"trajectory": Trajectory, "hashgrid": HashGrid}


def make_deformation(
    name: str,
    means: np.ndarray,
    frames: int,
    unit: float,
    seed: int,
    tracks: np.ndarray | None,
    fixed: np.ndarray | None,
) -> Deformation:
    """Create a model by its name in `MODELS`. Without points it is `trajectory`, which needs none.

    It starts from `tracks` [T, N, 3], or at rest. Points that are `fixed` [N] bool never move. `unit` is the typical
    viewing distance.
    """
    model = MODELS[name] if len(means) else Trajectory
    return model(means, frames, unit, seed, tracks, fixed)


CANONICAL_RATES = {
    "means": 3.6e-4,
    "quats": 8e-3,
    "log_scales": 2.4e-2,
    "logit_opacities": 8e-2,
    "sh_base": 1.6e-2,
    "sh_rest": 4e-4,
}
"""Learning rates; of means per viewing distance. They are higher than a keyframe's, since moving points may be hidden at the
keyframe, and added points are guesses."""


@dataclass(frozen=True)
class Changes:
    """Difference from the keyframe: dx [N, 3], dq [N, 4], and shade [N, 4] as `Appearance.at`; None if appearance is fixed."""

    dx: np.ndarray
    dq: np.ndarray
    shade: np.ndarray | None


class DynamicPoints:
    """Dynamic points in three parts, whose rows are added and removed together. `appearance` is None if it is fixed."""

    def __init__(self, canonical: TrainablePoints, deformation: Deformation, appearance: Appearance | None) -> None:
        self.canonical = canonical
        self.deformation = deformation
        self.appearance = appearance

    @staticmethod
    def of(start: GroupStart, images: TrainingImages, config: GroupConfig, seed: int) -> DynamicPoints:
        """Create the points from which a group's training starts."""
        rates = CANONICAL_RATES | {"means": CANONICAL_RATES["means"] * images.unit}
        canonical, shades = TrainablePoints.from_gaussians(start.dynamic, rates), start.shades
        fixed = None if shades is None else (shades != 0).any((0, 2))
        scene = canonical.means, images.count, images.unit
        deformation = make_deformation(config.deformation, *scene, seed, start.tracks, fixed)
        if not config.appearance:
            return DynamicPoints(canonical, deformation, None)
        cuts = detect_cuts(images.pixels)
        return DynamicPoints(canonical, deformation, Appearance(images.count, len(canonical), shades, cuts))

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.canonical)

    @property
    def means(self) -> np.ndarray:
        """Positions at the keyframe, [N, 3] world."""
        return self.canonical.means

    def changes(self, moment: float) -> Changes:
        """Return the changes at a moment, in frames of the group."""
        dx, dq = self.deformation.offsets(self.means, moment)
        return Changes(dx, dq, None if self.appearance is None else self.appearance.at(moment))

    def splats(self, changes: Changes, view: View, near: float) -> Splats:
        """Project the points with these changes."""
        return deformed(self.canonical.params, (changes.dx, changes.dq), changes.shade, view, near)

    def at(self, moment: float, view: View, near: float) -> Splats:
        """Project the points at a moment, in frames of the group."""
        return self.splats(self.changes(moment), view, near)

    def highest_logits(self) -> np.ndarray:
        """Return the logits [N] of the opacities, each at the moment of its maximum."""
        logits = self.canonical.params["logit_opacities"]
        return logits if self.appearance is None else logits + self.appearance.highest

    def snapshot(self) -> Restore:
        """Copy everything that training changes."""
        return merge_snapshots([part.snapshot() for part in self._parts])

    def check(self) -> None:
        """Raise a `GaussiansError` if a value is NaN or infinite."""
        for part in self._parts:
            part.check()

    def keep(self, index: np.ndarray) -> None:
        """Keep the rows of an index [M] int64, in its order; keep all if the index is empty."""
        if len(index) == 0:
            return
        self.canonical.keep(index)
        self.deformation.keep(index)
        if self.appearance is not None:
            self.appearance.keep(index)

    def clone(self, index: np.ndarray) -> None:
        """Add copies of rows [M] int64, with their motion and appearance."""
        self._append(self.canonical.rows(index), index)

    def append(self, params: Mapping[str, np.ndarray]) -> None:
        """Add points at rest. params: unconstrained arrays, as in `TrainablePoints`."""
        self._append(params, None)

    @property
    def _parts(self) -> list[TrainablePoints | Deformation | Appearance]:
        parts: list[TrainablePoints | Deformation | Appearance] = [self.canonical, self.deformation]
        return parts if self.appearance is None else [*parts, self.appearance]

    def _append(self, params: Mapping[str, np.ndarray], parents: np.ndarray | None) -> None:
        count = len(params["means"])
        if count == 0:
            return
        self.canonical.append(params)
        self.deformation.append(params["means"], parents)
        if self.appearance is not None:
            self.appearance.append(count, parents)
