"""Layers of a live reel are retired together, again and again: what is still there of them is written anew.

Without that, everything that ever rested would have to be got by who joins, for hours.
"""

from __future__ import annotations

from splatreel.recon.run.store import Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.static_points import StaticPoints

EPOCH = 64
"""Groups after which the static points are written anew."""


def is_renewed(group: int) -> bool:
    """Whether the layers of before are retired at a group."""
    return group > 0 and group % EPOCH == 0


def retired_at(group: int) -> int:
    """When the layers that are born at a group are."""
    return (group // EPOCH + 1) * EPOCH


def keep_epochs(store: Store, group: int) -> None:
    """So that whoever reads the checkpoints knows it, up to a group."""
    store.save_chapter_firsts(list(range(0, retired_at(group) + 1, EPOCH)))


def trained_points(store: Store, group: int) -> Gaussians:
    """All static points as a group ends, as they were trained: what is written again and again would lose each time."""
    return Gaussians.concatenate([Gaussians.empty(0), *(layer.trained for _, layer in store.layers(group))])


def static_before(store: Store, group: int, sh_degree: int) -> StaticPoints:
    """The static points that a group finds, all of them taken for alive."""
    if group == 0 or is_renewed(group):
        return StaticPoints.none(sh_degree)
    return StaticPoints.none(sh_degree).with_layer(store.static(group - 1))
