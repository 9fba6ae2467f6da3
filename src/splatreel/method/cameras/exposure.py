"""Exposures of the cameras and light of the scene during a group, relative to the first frame of the capture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.base.paged_arrays import release_pages
from splatreel.base.progress import Progress
from splatreel.method.cameras.rig import Rig

CHANGED = 0.02
"""Smallest change of an exposure or of the light that is reported, as a share."""


@dataclass(frozen=True)
class Exposure:
    """Logarithms of factors at every frame of a group: `change` [T, C, 3] of each camera, `light` [T, 3] common to all cameras."""

    change: np.ndarray
    light: np.ndarray

    @property
    def light_factors(self) -> np.ndarray | None:
        """Factors [T, 3] float32, as in `Group.light`; None where the light does not change."""
        return np.exp(self.light) if self.light.any() else None


def measure_exposure(rig: Rig, frames: np.ndarray, reference: np.ndarray | None = None) -> Exposure:
    """Return the exposures and the light of a group.

    The frames [T, C, H, W, 3] are compared with `reference` [C, H, W, 3] or the keyframe, at which `rig` has its
    exposures.
    """
    change, light = exposures(frames, reference)
    return Exposure(change + rig.exposure, light + rig.light)


def report_exposure(rig: Rig, found: Exposure, progress: Progress) -> None:
    """Report visible changes of exposures and light."""
    most = np.abs(found.change).max((0, 2))
    if most.max() > CHANGED:
        name = rig.names[int(most.argmax())]
        progress.note(f"exposures change by up to {most.max():.0%} ({name}): removed from the images")
    if (most := np.abs(np.expm1(found.light)).max()) > CHANGED:
        progress.note(
            f"the light changes by up to {most:.0%}: removed from the images, restored when the reel is played"
        )


def remove_exposure(frames: np.ndarray, exposure: Exposure) -> None:
    """Give images [T, C, H, W, 3] uint8 the exposure and the light of the capture's first frame, in place."""
    even_out(frames, exposure.change + exposure.light[:, None])


def at_next_keyframe(rig: Rig, exposure: Exposure, own: int) -> Rig:
    """Return the rig with its exposures at the next keyframe. `own` is the number of the group's frames without the overlap."""
    keyframe = min(own, len(exposure.change) - 1)  # without an overlap, the last frame is the nearest
    return replace(rig, exposure=exposure.change[keyframe], light=exposure.light[keyframe])


BLOCKS = 40
"""Blocks along the longer side of an image, whose means are compared. Means have little noise, and motion affects few blocks."""
BLOCK_TOLERANCE = 0.02
"""Maximum difference between static blocks, as a logarithm of a ratio."""
MIN_STATIC_SHARE = 0.15
"""Minimum share of such blocks. Frames with fewer give no estimate."""
MIN_GRAY, MAX_GRAY = 16, 250
"""Minimum gray level of a block's mean, and gray level above which a pixel is overexposed. Ratios outside are unreliable."""
SPREAD_TOLERANCE = 0.04
"""Blocks that differ from the others by at most this logarithm show how uniform a change is."""
MIN_SPREADS = 4.0
"""Minimum change of exposure, in multiples of the spread of the blocks."""
MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution, in multiples of its median absolute deviation."""
MIN_STANDARD_ERRORS = 3.0
"""Standard errors by which cameras must agree on a change of the scene's light."""
WHITE_FADE_FROM = 240
"""Gray level above which a correction fades, so that white stays white."""
WHITE_FADE_CHANGES = 0.15, 0.3
"""Logarithms of a change: up to the first, corrections of white fade, since white is overexposed in either light. From the
second on they do not: the pixel is a white wall that was gray."""


def exposures(frames: np.ndarray, reference: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the logarithms of each camera's exposure [T, C, 3] and of the light [T, 3], relative to the reference or the first frame.

    Automatic exposure and clouds multiply all pixels of a camera by the same factor. Comparisons of frames would take such a change
    for motion, and static points cannot follow it (beyond the paper). Local changes, such as light from a wall, remain.

    An image changes by the sum of both: the factor that most blocks agree on, if it exceeds `MIN_SPREADS` times their
    spread. The light is the common part of all cameras, if it exceeds `MIN_STANDARD_ERRORS` standard errors. Both
    shrink to zero near their limit.
    """

    def of(camera: int) -> np.ndarray:
        found = _exposure_changes(frames[:, camera], None if reference is None else reference[camera])
        release_pages(frames)
        return found

    changes = np.stack(threads.map_parallel(of, range(frames.shape[1])), 1)
    light = _common_light(changes)
    return (changes - light[:, None]).astype(np.float32), light.astype(np.float32)


def even_out(frames: np.ndarray, change: np.ndarray) -> None:
    """Remove logarithmic changes [T, C, 3] from frames [T, C, H, W, 3] uint8, in place."""
    levels = np.arange(256)[:, None]
    white = 1 - np.clip((255 - levels) / (255 - WHITE_FADE_FROM), 0, 1)
    changed = np.argwhere(np.any(change != 0, 2))

    def correct(frame: int) -> None:
        for t, c in changed[changed[:, 0] == frame]:
            kept = np.interp(np.abs(change[t, c]).max(), WHITE_FADE_CHANGES, (1, 0))
            fade = 1 - white * kept
            table = np.rint(levels * (1 + fade * np.expm1(-change[t, c]))).clip(0, 255).astype(np.uint8)
            frames[t, c] = cv2.LUT(frames[t, c], table[None])
        release_pages(frames)

    threads.map_parallel(correct, np.unique(changed[:, 0]))


def _exposure_changes(film: np.ndarray, reference: np.ndarray | None) -> np.ndarray:
    """Return the change of exposure [T, 3] of one camera's frames [T, H, W, 3], as logarithms relative to the reference [H, W, 3]."""
    shrink = BLOCKS / max(film.shape[1:3])
    size = max(1, round(shrink * film.shape[2])), max(1, round(shrink * film.shape[1]))
    blocks = [_blocks(frame, size) for frame in film]
    base = blocks[0] if reference is None else _blocks(reference, size)
    found = np.array([_common_ratio(block - base) for block in blocks])  # [T, 4], the spread last
    known = np.flatnonzero(~np.isnan(found[:, 3]))
    if len(known) == 0:
        return np.zeros((len(film), 3))
    change = np.stack([np.interp(np.arange(len(found)), known, found[known, k]) for k in range(3)], 1)
    share = _shrinkage(np.square(MIN_SPREADS * found[known, 3]).sum(), np.square(found[known, :3].mean(1)).sum())
    return share * change


def _blocks(frame: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the log mean colors [N, 3] of blocks; NaN for blocks that are too dark or partly overexposed."""
    mean = cv2.resize(frame.astype(np.float32), size, interpolation=cv2.INTER_AREA).reshape(-1, 3)
    plain = cv2.inRange(frame, (0, 0, 0), (MAX_GRAY - 1,) * 3).astype(np.float32)  # 255 where no color is overexposed
    use = (mean.min(1) >= MIN_GRAY) & (cv2.resize(plain, size, interpolation=cv2.INTER_AREA).ravel() == 255)
    return np.where(use[:, None], np.log(np.maximum(mean, 1)), np.nan)


def _common_ratio(ratios: np.ndarray) -> np.ndarray:
    """Return the median color of the largest set of similar blocks, and the spread around it, [4]; NaN if the set is small.

    ratios: [N, 3] logarithms, or NaN.
    """
    ratios = ratios[~np.isnan(ratios[:, 0])]
    gray = ratios.mean(1)
    ordered = np.sort(gray)
    counts = np.searchsorted(ordered, ordered + BLOCK_TOLERANCE, "right") - np.arange(len(ordered))
    if len(ordered) == 0 or counts.max() < MIN_STATIC_SHARE * len(ratios):
        return np.full(4, np.nan)
    low = ordered[counts.argmax()]
    middle = np.median(ratios[(gray >= low) & (gray <= low + BLOCK_TOLERANCE)], 0)
    around = np.abs(gray - middle.mean())
    return np.append(middle, MAD_TO_SIGMA * np.median(around[around <= SPREAD_TOLERANCE]))


def _common_light(changes: np.ndarray) -> np.ndarray:
    """Return the common part [T, 3] of all cameras' changes [T, C, 3], shrunk to zero where it may be chance."""
    mean = changes.mean(1)
    chance = changes.var(1).sum() / changes.shape[1]
    return _shrinkage(MIN_STANDARD_ERRORS**2 * chance, np.square(mean).sum()) * mean


def _shrinkage(least: float, found: float) -> float:
    """Return the share, by squares, that is kept of a measurement: 0 up to `least`, nearly 1 far above."""
    return max(0.0, 1 - least / found) if found > 0 else 0.0
