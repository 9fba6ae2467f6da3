"""The scale of a calibrated rig from a board that some of its cameras see at the same time."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from splatreel.calibration.boards.board import Board, Sighting
from splatreel.calibration.boards.board_sightings import Sightings

WIDEST = 1.2
"""Maximum ratio between the scales of the middle half of all frames."""


def board_scale(views: dict[str, Any], board: Board, sightings: Sightings) -> float | str:
    """Return the meters per unit of a calibrated rig, or the reason why the board does not give them.

    Args:
        views: pycolmap.Image of each camera, with its pose and lens.
        board: The board.
        sightings: Sightings of the board.
    """
    scales = []
    for seen in sightings.found.values():
        scales += [
            scale
            for one, other in combinations([name for name in seen if name in views], 2)
            if (scale := _scale(board, [(views[name], seen[name]) for name in (one, other)])) is not None
        ]
    if not scales:
        seen = sorted({name for names in sightings.found.values() for name in names})
        where = (
            f"Cameras that see it at any time: {', '.join(seen)}" if seen else f"No camera sees it{_others(sightings)}"
        )
        return (
            f"no frame shows the board {board.spec} to two of the placed cameras, so that there is no scale. {where}. Hold it "
            f"closer to two cameras, or give the distance of two cameras with --distance."
        )
    low, middle, high = np.percentile(scales, [25, 50, 75])
    if high > WIDEST * low:
        return (
            f"the scale by the board {board.spec} is {low:.3g} to {high:.3g} meters per unit in different frames, which do not agree. "
            f"Hold it still and closer to the cameras, and run `splatreel capture sync` first if the videos do not start together."
        )
    return float(middle)


def _others(sightings: Sightings) -> str:
    """Return what the cameras see in place of the board, as the end of a sentence."""
    return next((f", but {other}" for counts in sightings.others.values() for other, _ in counts.most_common(1)), "")


def _scale(board: Board, pair: list[tuple[Any, Sighting]]) -> float | None:
    """Return the meters per unit by two cameras' sightings; None if they share too few corners or stand at one place."""
    (_, one), (_, other) = pair
    shared, here, there = np.intersect1d(one.corners, other.corners, return_indices=True)
    if len(shared) < 3:
        return None
    centers, rays = [], []
    for (view, sighting), rows in zip(pair, (here, there), strict=True):
        pose = np.asarray(view.cam_from_world().matrix())
        sight = np.column_stack([view.camera.cam_from_img(sighting.places[rows]), np.ones(len(rows))]) @ pose[:, :3]
        rays.append(sight / np.linalg.norm(sight, axis=1, keepdims=True))
        centers.append(-pose[:, :3].T @ pose[:, 3])
    across = [np.eye(3) - ray[:, :, None] * ray[:, None] for ray in rays]
    normal = across[0] + across[1]
    if np.linalg.cond(normal).max() > 1e6:
        return None
    points = np.linalg.solve(normal, (across[0] @ centers[0] + across[1] @ centers[1])[..., None])[..., 0]
    sizes = [
        np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(len(shared), 1)]
        for places in (points, board.points[shared])
    ]
    return float(np.median(sizes[1] / np.maximum(sizes[0], 1e-12)))
