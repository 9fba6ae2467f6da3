"""Exposures and light that change while a capture is filmed: phones set theirs by themselves, clouds pass (beyond the paper).

Everything that compares frames would take such a change for motion, and static points cannot follow it. It multiplies the whole of
one camera's pictures by the same factor, and is taken out of them. What all cameras see at once is the light of the whole scene: a
reel says it, and it comes back when it is played. What differs from place to place, such as what bodies take from a wall, stays.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

from splatreel import threads
from splatreel.capture.frame_file import release_pages

BLOCKS = 40
"""Blocks along the longer side of a picture, whose means are compared: noise is gone, and what moves spoils few."""
WINDOW = 0.02
"""Blocks that rest differ by no more than this logarithm of a ratio."""
FEWEST = 0.15
"""Share of the blocks that must do so; of a frame with fewer nothing is known."""
DARK, BRIGHT = 16, 250
"""Gray levels of a block's mean below which, and of a pixel from which on, ratios say nothing."""
AROUND = 0.04
"""Blocks that differ from the others by no more than this, of the same logarithm, show how alike a change is everywhere."""
ALIKE = 4.0
"""Times the spread of the blocks that a change must have to be an exposure."""
NORMAL = 1.4826
"""Standard deviation of what is normal, by the median distance from its middle."""
CERTAIN = 3.0
"""Standard errors by which cameras must agree on a change that is the scene's."""
SHOULDER = 240
"""Gray level from which on a correction fades: what is white stays white."""
DAZZLING = 0.15, 0.3
"""Logarithms of a change up to which it does, for what is white is too bright in either light; from the second on it is a white wall
that was gray, and does not."""


def exposures(frames: np.ndarray, reference: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """How each camera's exposure, and the light, differ from those of a reference, by default the first frame.

    frames: [T, C, H, W, 3] uint8, the keyframe first. reference: [C, H, W, 3] uint8.

    Returns exposures [T, C, 3] and light [T, 3], float32: logarithms of the factor in each color. A camera's pictures change by the
    sum of both, the factor that most blocks of a picture agree on, if that is more than `ALIKE` times their spread. The light is what
    the cameras have in common, if that is more than `CERTAIN` times what chance could do. Either is shrunk towards nothing as it
    comes near to its limit.
    """

    def of(camera: int) -> np.ndarray:
        found = _changes(frames[:, camera], None if reference is None else reference[camera])
        release_pages(frames)
        return found

    with ThreadPoolExecutor(threads.count()) as pool:
        changes = np.stack(list(pool.map(of, range(frames.shape[1]))), 1)
    light = _common(changes)
    return (changes - light[:, None]).astype(np.float32), light.astype(np.float32)


def even_out(frames: np.ndarray, change: np.ndarray) -> None:
    """Take changes out of frames, in place. frames: [T, C, H, W, 3] uint8. change: [T, C, 3] logarithms."""
    levels = np.arange(256)[:, None]
    white = 1 - np.clip((255 - levels) / (255 - SHOULDER), 0, 1)
    for number, (t, c) in enumerate(np.argwhere(np.any(change != 0, 2))):
        if number % frames.shape[1] == 0:
            release_pages(frames)
        fade = 1 - white * np.interp(np.abs(change[t, c]).max(), DAZZLING, (1, 0))
        table = np.rint(levels * (1 + fade * np.expm1(-change[t, c]))).clip(0, 255).astype(np.uint8)
        frames[t, c] = cv2.LUT(frames[t, c], table[None])


def _changes(film: np.ndarray, reference: np.ndarray | None) -> np.ndarray:
    """[T, H, W, 3] of one camera to [T, 3]: the logarithm by which it exposed more than in the reference [H, W, 3]."""
    shrink = BLOCKS / max(film.shape[1:3])
    size = max(1, round(shrink * film.shape[2])), max(1, round(shrink * film.shape[1]))
    blocks = [_blocks(frame, size) for frame in film]
    base = blocks[0] if reference is None else _blocks(reference, size)
    found = np.array([_agreed(block - base) for block in blocks])  # [T, 4], the spread at last
    known = np.flatnonzero(~np.isnan(found[:, 3]))
    if len(known) == 0:
        return np.zeros((len(film), 3))
    change = np.stack([np.interp(np.arange(len(found)), known, found[known, k]) for k in range(3)], 1)
    return _beyond(np.square(ALIKE * found[known, 3]).sum(), np.square(found[known, :3].mean(1)).sum()) * change


def _blocks(frame: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """[N, 3] logarithm of the blocks' mean colors; NaN where they are too dark, or a part of them is white."""
    mean = cv2.resize(frame.astype(np.float32), size, interpolation=cv2.INTER_AREA).reshape(-1, 3)
    plain = cv2.inRange(frame, (0, 0, 0), (BRIGHT - 1,) * 3).astype(np.float32)  # 255 where no color is at its end
    use = (mean.min(1) >= DARK) & (cv2.resize(plain, size, interpolation=cv2.INTER_AREA).ravel() == 255)
    return np.where(use[:, None], np.log(np.maximum(mean, 1)), np.nan)


def _agreed(ratios: np.ndarray) -> np.ndarray:
    """[4] median colors of the largest set of blocks that lie within `WINDOW`, and the spread of those around; NaN if it is small.

    ratios: [N, 3] logarithms, or NaN.
    """
    ratios = ratios[~np.isnan(ratios[:, 0])]
    gray = ratios.mean(1)
    ordered = np.sort(gray)
    counts = np.searchsorted(ordered, ordered + WINDOW, "right") - np.arange(len(ordered))
    if len(ordered) == 0 or counts.max() < FEWEST * len(ratios):
        return np.full(4, np.nan)
    low = ordered[counts.argmax()]
    middle = np.median(ratios[(gray >= low) & (gray <= low + WINDOW)], 0)
    around = np.abs(gray - middle.mean())
    return np.append(middle, NORMAL * np.median(around[around <= AROUND]))


def _common(changes: np.ndarray) -> np.ndarray:
    """[T, 3] what the cameras have in common, shrunk to nothing where that may be chance. changes: [T, C, 3]."""
    mean = changes.mean(1)
    chance = changes.var(1).sum() / changes.shape[1]
    return _beyond(CERTAIN**2 * chance, np.square(mean).sum()) * mean


def _beyond(least: float, found: float) -> float:
    """The share of something that is kept, by its square: none up to what is the least, nearly all far beyond."""
    return max(0.0, 1 - least / found) if found > 0 else 0.0
