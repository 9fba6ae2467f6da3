"""The dynamic points of a group while it trains: Gaussians at the keyframe, how they move, and how their appearance changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from splatreel.config import GroupConfig
from splatreel.recon.deform.adam import Restore, together
from splatreel.recon.deform.appearance import Appearance, detect_cuts
from splatreel.recon.deform.models import make_deformation
from splatreel.recon.deform.protocol import Deformation
from splatreel.recon.layering.tracking import GroupStart
from splatreel.recon.train.pictures import Pictures
from splatreel.recon.train.points import TrainablePoints
from splatreel.recon.train.render import Splats, View, deformed

CANONICAL_RATES = {
    "means": 3.6e-4,
    "quats": 8e-3,
    "log_scales": 2.4e-2,
    "logit_opacities": 8e-2,
    "sh_base": 1.6e-2,
    "sh_rest": 4e-4,
}
"""Means per viewing distance. Bolder than a keyframe's: what moves is hidden at times, and what appeared was only guessed."""


@dataclass(frozen=True)
class Changes:
    """What differs from the keyframe at a moment. dx: [N, 3] world units; dq: [N, 4]; shade: [N, 4] as `Appearance.at`, or None."""

    dx: Tensor
    dq: Tensor
    shade: Tensor | None


class MovingPoints:
    """N points in three parts, whose rows come and go together. canonical: as they are at the keyframe. appearance: None, if fixed."""

    def __init__(self, canonical: TrainablePoints, deformation: Deformation, appearance: Appearance | None) -> None:
        self.canonical, self.deformation, self.appearance = canonical, deformation, appearance

    @staticmethod
    def of(start: GroupStart, pictures: Pictures, config: GroupConfig, seed: int) -> MovingPoints:
        """Where a group's training starts, on the device of its pictures."""
        device = pictures.images.device
        rates = CANONICAL_RATES | {"means": CANONICAL_RATES["means"] * pictures.unit}
        canonical = TrainablePoints.from_gaussians(start.dynamic, rates, device)
        tracks, shades = (None if a is None else torch.from_numpy(a).to(device) for a in (start.tracks, start.shades))
        fixed = None if shades is None else shades.any(2).any(0)
        means = canonical.means.detach()
        deformation = make_deformation(config.deformation, means, pictures.count, pictures.unit, seed, tracks, fixed)
        if not config.appearance:
            return MovingPoints(canonical, deformation, None)
        cuts = detect_cuts(pictures.images)
        return MovingPoints(canonical, deformation, Appearance(pictures.count, len(canonical), device, shades, cuts))

    def __len__(self) -> int:
        return len(self.canonical)

    @property
    def means(self) -> Tensor:
        """[N, 3] at the keyframe, world."""
        return self.canonical.means

    def changes(self, moment: float) -> Changes:
        """At a moment, in frames of the group. Gradients that its tensors get are followed by the next step."""
        dx, dq = self.deformation.offsets(self.means, moment)
        return Changes(dx, dq, None if self.appearance is None else self.appearance.at(moment))

    def splats(self, changes: Changes, view: View, near: float) -> Splats:
        """As a view sees them with those changes."""
        return deformed(self.canonical.params, (changes.dx, changes.dq), changes.shade, view, near)

    def at(self, moment: float, view: View, near: float) -> Splats:
        """As a view sees them at a moment, in frames of the group."""
        return self.splats(self.changes(moment), view, near)

    def highest_logits(self) -> Tensor:
        """[N] logits of the opacities, at the moment when each is highest."""
        logits = self.canonical.params["logit_opacities"]
        return logits if self.appearance is None else logits + self.appearance.highest

    def step(self, share: float, pace: float = 1.0) -> None:
        """Follow the gradients and clear them. share: 0..1, how much of training is over. pace: times the learning rates."""
        self.canonical.scale_rates({}, default=pace * 0.1**share)
        self.canonical.step()
        self.deformation.step(share, pace)
        if self.appearance is not None:
            self.appearance.step(share, pace)

    def snapshot(self) -> Restore:
        """What training changes, copied."""
        return together([part.snapshot() for part in self._parts])

    def check(self) -> None:
        """Raises `GaussiansError` if a value is NaN or infinite."""
        for part in self._parts:
            part.check()

    def keep(self, index: Tensor) -> None:
        """Keep the rows of an index [M] int64, in its order; all, if there are none."""
        if len(index) == 0:
            return
        self.canonical.keep(index)
        self.deformation.keep(index)
        if self.appearance is not None:
            self.appearance.keep(index)

    def clone(self, index: Tensor) -> None:
        """Add copies of rows, [M] int64, which move and look as these do."""
        self._append(self.canonical.rows(index), index)

    def append(self, params: Mapping[str, Tensor]) -> None:
        """Add points that rest so far. params: unconstrained, as `TrainablePoints` has them."""
        self._append(params, None)

    @property
    def _parts(self) -> list[TrainablePoints | Deformation | Appearance]:
        parts: list[TrainablePoints | Deformation | Appearance] = [self.canonical, self.deformation]
        return parts if self.appearance is None else [*parts, self.appearance]

    def _append(self, params: Mapping[str, Tensor], parents: Tensor | None) -> None:
        count = len(params["means"])
        if count == 0:
            return
        self.canonical.append(params)
        self.deformation.append(params["means"], parents)
        if self.appearance is not None:
            self.appearance.append(count, parents)
