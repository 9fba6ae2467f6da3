"""Shares of the images that masks cover, and sentences about implausible ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splatreel.base.progress import listed
from splatreel.scene.camera import Camera

SHOWN = 128
"""Smallest gray level of a pixel that shows the subject."""
LARGE = 0.6
"""Share of an image that a subject rarely covers."""
EMPTY = 0.0005
"""Share of an image below which a mask is empty."""
STEP, JUMP = 0.02, 3.0
"""Smallest difference between the shares of neighboring frames, and smallest ratio, of an abrupt change."""
RANGE = 0.15
"""Smallest difference between the largest and the usual share of a camera that is named, if the ratio is `JUMP`, too."""
UNLIKE = 4.0
"""Smallest ratio of a camera's share to the one that the distances of the cameras explain."""

COMPARED_WIDTH = 480
"""Largest width of the images in which motion is searched, pixels."""
CHANGED, MOVING = 30, 0.002
"""Smallest change of a pixel by motion, gray levels, and share of an image that changes where something moves."""
NEAR_MASK, FEW_CHANGES = 0.02, 0.3
"""Distance from a mask within which changes are its own, in widths of the image; and the share of changes below which it is named."""


def mask_shares(masks: np.ndarray) -> np.ndarray:
    """Return the shares [...] of masks [..., H, W] uint8 that show the subject, 0..1."""
    return (masks >= SHOWN).mean((-2, -1))


def describe_shares(names: Sequence[str], shares: np.ndarray, first: int = 0) -> list[str]:
    """Return a sentence about the share that the masks of each camera cover, and sentences about implausible shares.

    Args:
        names: Names of the cameras.
        shares: [T, C] shares of consecutive frames, 0..1; NaN where a camera has no image.
        first: Number of the first frame.
    """
    seen = {name: column[~np.isnan(column)] for name, column in zip(names, shares.T, strict=True)}
    means = {name: float(column.mean()) if len(column) else 0.0 for name, column in seen.items()}
    found = [f"the masks cover, of the images of {', '.join(f'{name} {mean:.1%}' for name, mean in means.items())}"]
    black = [name for name in names if not (seen[name] >= EMPTY).any()]
    if black:
        found.append(f"the masks of {listed(black)} are black: no subject is seen there")
    full = [name for name in names if np.median([*seen[name], 0.0][: max(len(seen[name]), 1)]) > LARGE]
    if full:
        found.append(
            f"the masks of {listed(full)} cover most of the image, which is implausible for a subject: are they inverted, or white "
            f"everywhere?"
        )
    for name in names:
        if name not in black:
            found += _changes(name, shares[:, names.index(name)], first, name in full)
    return found


def _changes(name: str, shares: np.ndarray, first: int, is_full: bool) -> list[str]:
    """Return sentences about changes of a camera's shares [T] over the frames. `is_full` names no large masks again."""
    there = np.flatnonzero(~np.isnan(shares))
    values = shares[there]
    if len(values) < 2:
        return []
    usual = float(np.median(values[values >= EMPTY]))
    empty = _abruptly_empty(values)
    large = (values > JUMP * usual) & (values > usual + RANGE) & (not is_full)
    found = []
    if empty.any():
        found.append(f"the masks of {name} are empty in frames {_frames(there[empty] + first)}, {usual:.1%} are usual")
    if large.any():
        found.append(
            f"the masks of {name} cover up to {values.max():.0%} of the image in frames {_frames(there[large] + first)}, {usual:.1%} "
            f"are usual: has the light changed?"
        )
    before, after = values[:-1], values[1:]
    low, high = np.minimum(before, after), np.maximum(before, after)
    abrupt = (high - low > STEP) & (high > JUMP * low)
    abrupt &= ~(empty | large)[:-1] & ~(empty | large)[1:]  # said already
    if abrupt.any():
        at = int(np.flatnonzero(abrupt)[0])
        found.append(
            f"the masks of {name} change abruptly at frame{'s' * int(abrupt.sum() > 1)} {_frames(there[1:][abrupt] + first)}, from "
            f"{values[at]:.1%} to {values[at + 1]:.1%} of the image"
        )
    return found


def _abruptly_empty(values: np.ndarray) -> np.ndarray:
    """Return the frames [T] bool without a mask, where a frame beside them has a mask larger than `STEP`."""
    parts = np.split(np.arange(len(values)), np.flatnonzero(np.diff(values < EMPTY)) + 1)
    found = np.zeros(len(values), bool)
    for part in parts:
        beside = [values[at] for at in (part[0] - 1, part[-1] + 1) if 0 <= at < len(values)]
        found[part] = values[part[0]] < EMPTY and max(beside, default=0.0) > STEP
    return found


def describe_sizes(cameras: Sequence[Camera], masks: np.ndarray) -> list[str]:
    """Return a sentence about cameras whose masks are much larger or smaller than the distances of the cameras explain.

    Args:
        cameras: C cameras.
        masks: [M, C, H, W] uint8 of M moments.
    """
    ratios = np.array([_size_ratios(cameras, moment >= SHOWN) for moment in masks])
    known = ~np.isnan(ratios).all(0)
    typical = np.full(len(cameras), np.nan)
    typical[known] = np.nanmedian(ratios[:, known], 0)
    odd = [
        f"{camera.name} ({ratio:.1f} times larger)" if ratio > 1 else f"{camera.name} ({1 / ratio:.1f} times smaller)"
        for camera, ratio in zip(cameras, typical.tolist(), strict=True)
        if ratio > UNLIKE or ratio < 1 / UNLIKE
    ]
    if not odd:
        return []
    return [
        f"masks are not as large as the distances of the cameras explain, in {listed(odd)}: look at these masks, and at the poses"
    ]


def describe_motion(names: Sequence[str], images: np.ndarray, masks: np.ndarray) -> list[str]:
    """Return a sentence about cameras whose masks hold hardly any of what changes between two moments.

    Such masks are shifted, of another capture, or of a part of the subject.

    Args:
        names: Names of the cameras.
        images: [2, C, H, W, 3] uint8 of two moments.
        masks: [2, C, H, W] uint8.
    """
    from scipy.ndimage import maximum_filter, uniform_filter  # takes a second

    step = max(1, images.shape[3] // COMPARED_WIDTH)
    small = uniform_filter(images[:, :, ::step, ::step].astype(np.float32), size=(1, 1, 3, 3, 1))  # type: ignore[arg-type]
    changed = np.abs(small[1] - small[0]).max(-1) > CHANGED
    near = 2 * int(NEAR_MASK * changed.shape[2]) + 1
    within = maximum_filter((masks[:, :, ::step, ::step] >= SHOWN).any(0), (0, near, near))
    found = [
        f"{name} ({(change & held).sum() / change.sum():.0%})"
        for name, change, held in zip(names, changed, within, strict=True)
        if change.mean() >= MOVING and (change & held).sum() < FEW_CHANGES * change.sum()
    ]
    if not found:
        return []
    return [
        f"masks hold hardly any of what moves, in {listed(found)}: are they shifted, of another capture, or of a part of the subject "
        f"only?"
    ]


def _size_ratios(cameras: Sequence[Camera], masks: np.ndarray) -> np.ndarray:
    """Return the size of each mask [C, H, W] bool relative to the one that the cameras' distances explain, [C]. Others are NaN.

    Masks that reach the border of their image may be cut off there, so they are not too small.
    """
    found = np.full(len(cameras), np.nan)
    shown = np.flatnonzero(masks.mean((1, 2)) >= EMPTY).tolist()
    if len(shown) < 3:
        return found
    centers, rays = [], []
    for c in shown:
        row, column = (places.mean() + 0.5 for places in np.nonzero(masks[c]))
        ray = cameras[c].viewmat[:3, :3].T @ np.linalg.solve(cameras[c].K, [column, row, 1.0])
        centers.append(cameras[c].center)
        rays.append(ray / np.linalg.norm(ray))
    across = np.eye(3) - np.einsum("ni,nj->nij", rays, rays)
    if np.linalg.eigvalsh(across.mean(0))[0] < 1e-4:  # parallel
        return found
    place = np.linalg.solve(across.sum(0), np.einsum("nij,nj->i", across, np.array(centers)))
    distances = np.linalg.norm(np.array(centers) - place, axis=1)
    focals = np.array([cameras[c].K[0, 0] * cameras[c].K[1, 1] for c in shown])
    sizes = masks[shown].sum((1, 2)) * distances**2 / focals
    ratios = sizes / np.median(sizes)
    border = [masks[c][[0, -1]].any() or masks[c][:, [0, -1]].any() for c in shown]
    found[shown] = np.where(border & (ratios < 1), np.nan, ratios)
    return found


def _frames(numbers: np.ndarray) -> str:
    parts = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    return listed([f"{part[0]}" if len(part) == 1 else f"{part[0]} to {part[-1]}" for part in parts])
