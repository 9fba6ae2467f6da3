"""Points with one attribute as decoded and all others as trained, to measure the error of one attribute's quantization."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from splatreel.codec.container import unpack_file
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

SECTIONS = {
    "position": ("means", "places"),
    "shape": ("shapes",),
    "opacity": ("opacities",),
    "color": ("sh_base",),
    "rest": ("sh_rest",),
    "motion": ("dx",),
    "turn": ("dq",),
    "shade": ("shade",),
}
"""Sections of a file by the field of `Steps` that quantizes them."""


def attribute_bytes(data: bytes) -> dict[str, int]:
    """Return the bytes of each attribute that a layer's or a group's file holds."""
    found = {name: len(section.data) for name, section in unpack_file(data)[1].items()}
    return {
        attribute: sum(found[name] for name in names)
        for attribute, names in SECTIONS.items()
        if all(name in found for name in names)
    }


def in_order(group: Group, order: np.ndarray) -> Group:
    """Return a group with its dynamic points in another order [N]."""
    shade = None if group.shade is None else group.shade[:, order]
    return replace(group, dynamic=group.dynamic[order], dx=group.dx[:, order], dq=group.dq[:, order], shade=shade)


def with_decoded(attribute: str, trained: Gaussians, decoded: Gaussians) -> Gaussians:
    """Return static points with one attribute of `decoded`. The points of both have the same order."""
    return _REPLACE[attribute](trained, decoded)


def with_decoded_at(attribute: str, trained: Group, decoded: Group, frame: float) -> Gaussians:
    """Return the dynamic points of `trained` at a frame, with one attribute of `decoded`. Both have the same order."""
    before, after = trained.dynamic, decoded.dynamic
    moment, other = trained.at(frame), decoded.at(frame)
    if attribute == "motion":
        return replace(moment, means=before.means + (other.means - after.means))
    if attribute == "turn":
        return replace(moment, quats=rotations.multiply(_turns(other, after), before.quats))
    if attribute == "shade":
        base = before.sh[:, 0] + other.sh[:, 0] - after.sh[:, 0]
        opacities = before.opacities + other.opacities - after.opacities
        return _recolored(moment, base, np.clip(opacities, 0, 1))
    if attribute == "position":
        return replace(moment, means=moment.means + (after.means - before.means))
    if attribute == "shape":
        return replace(moment, quats=rotations.multiply(_turns(moment, before), after.quats), scales=after.scales)
    if attribute == "opacity":
        return replace(moment, opacities=np.clip(moment.opacities + after.opacities - before.opacities, 0, 1))
    if attribute == "color":
        return _recolored(moment, moment.sh[:, 0] + after.sh[:, 0] - before.sh[:, 0], moment.opacities)
    return _REPLACE[attribute](moment, after)


def _turns(moment: Gaussians, canonical: Gaussians) -> np.ndarray:
    """Return the rotations [N, 4] about the world's axes that took canonical points to a moment."""
    return rotations.multiply(moment.quats, canonical.quats * np.array([1, -1, -1, -1], np.float32))


def _recolored(points: Gaussians, base: np.ndarray, opacities: np.ndarray) -> Gaussians:
    sh = np.concatenate([base[:, None], points.sh[:, 1:]], 1).astype(np.float32)
    return replace(points, sh=sh, opacities=opacities.astype(np.float32))


_REPLACE: dict[str, Callable[[Gaussians, Gaussians], Gaussians]] = {
    "position": lambda before, after: replace(before, means=after.means),
    "shape": lambda before, after: replace(before, quats=after.quats, scales=after.scales),
    "opacity": lambda before, after: replace(before, opacities=after.opacities),
    "color": lambda before, after: _recolored(before, after.sh[:, 0], before.opacities),
    "rest": lambda before, after: replace(before, sh=np.concatenate([before.sh[:, :1], after.sh[:, 1:]], 1)),
}
