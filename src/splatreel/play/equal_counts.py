"""Frames with the same number and order of Gaussians, for programs that interpolate between frames."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from splatreel.scene.gaussians import Gaussians

PAUSE = 3
"""Frames from the last one of a Gaussian to the first one of the next in its slot. In the two between, the slot is invisible: first
where the old one was, then where the new one will be. So interpolation moves nothing visible across the scene."""

Identified = tuple[Gaussians, np.ndarray]
"""Gaussians and their ids [N], see `Moment.ids`."""


class EqualCounts:
    """Frames in which each Gaussian has a slot of its own. The slot has opacity 0 while the Gaussian does not show.

    Attributes:
        count: Number of slots.
    """

    def __init__(self, times: Sequence[float], at: Callable[[float], Identified]) -> None:
        """Assign slots. `at` returns the Gaussians of the reel at one of the `times`, which are in order."""
        self._times, self._at = times, at
        self._ids, first, last, self._bands = _lives(at(seconds) for seconds in times)
        self._slots = _assign(first, last)
        self.count = int(self._slots.max(initial=-1)) + 1

    def __iter__(self) -> Iterator[Gaussians]:
        """Yield the Gaussians of each frame, in the order of their slots."""
        means, quats, scales = (
            np.zeros((self.count, 3)),
            np.tile([1.0, 0, 0, 0], (self.count, 1)),
            np.ones((self.count, 3)),
        )
        held = Gaussians(means, quats, scales, np.zeros(self.count), np.zeros((self.count, self._bands, 3)))
        following = self._at(self._times[0])
        for place in range(len(self._times)):
            (points, ids), held.opacities[:] = following, 0
            if place + 1 < len(self._times):
                following = self._at(self._times[place + 1])
                comes = ~np.isin(following[1], ids)
                self._put(following[0][comes].faded(0), following[1][comes], held)
            self._put(points, ids, held)
            yield Gaussians(*(getattr(held, name).copy() for name in held.ARRAYS), near=points.near)

    def _put(self, points: Gaussians, ids: np.ndarray, held: Gaussians) -> None:
        """Copy Gaussians into their slots, with rotations by the shorter way from those of the frame before."""
        slots = self._slots[np.searchsorted(self._ids, ids)]
        turned = np.sum(held.quats[slots] * points.quats, axis=1) < 0
        held.quats[slots] = np.where(turned[:, None], -points.quats, points.quats)
        for name in ("means", "scales", "opacities"):
            getattr(held, name)[slots] = getattr(points, name)
        held.sh[slots] = 0
        held.sh[slots, : points.sh.shape[1]] = points.sh


def _lives(frames: Iterable[Identified]) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Return all ids [P] in ascending order, the first and the last frame of each, and the largest number of harmonics."""
    known, first, last = np.zeros((3, 0), np.int64)
    bands = 1
    for frame, (points, ids) in enumerate(frames):
        new = np.setdiff1d(ids, known)
        if len(new):
            places = np.searchsorted(known, new)
            known, first, last = (
                np.insert(array, places, value) for array, value in ((known, new), (first, frame), (last, frame))
            )
        last[np.searchsorted(known, ids)] = frame
        bands = max(bands, points.sh.shape[1])
    return known, first, last, bands


def _assign(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the slot [P] of each Gaussian: the one that is free for the longest time, or a new one."""
    slots, free = np.zeros(len(first), np.int64), list[tuple[int, int]]()
    count = 0
    for place in np.argsort(first, kind="stable").tolist():
        if free and free[0][0] <= first[place]:
            slot = heapq.heappop(free)[1]
        else:
            slot, count = count, count + 1
        slots[place] = slot
        heapq.heappush(free, (int(last[place]) + PAUSE, slot))
    return slots
