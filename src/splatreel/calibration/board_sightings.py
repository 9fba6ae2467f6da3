"""Sightings of a calibration board in synchronized videos, and the scale of a rig from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
from PIL import Image

from splatreel.base import threads
from splatreel.base.progress import Progress
from splatreel.calibration.board import CHECKERBOARD, Board, Look, Sighting, family_of_markers
from splatreel.calibration.calibration_files import read_frame
from splatreel.capture.file_capture import FrameSource

LOOKS = 240
"""Maximum number of frames of a camera in which the board is searched, spread over the video."""
LONGEST = 1920
"""Longer side in pixels to which larger frames are reduced for the search."""
SHARED, OWN = 24, 12
"""Number of sightings to use of a camera: those that other cameras share, and any. The time has as many parts, and the
stillest sighting of each is taken. A moving board is blurred, and elsewhere for a camera that is late by part of a frame."""


@dataclass
class Sightings:
    """Sightings of a board.

    Attributes:
        found: Sightings by frame and camera.
        others: What frames showed in place of the board, by camera, with the number of frames.
    """

    found: dict[int, dict[str, Sighting]] = field(default_factory=dict)
    others: dict[str, Counter[str]] = field(default_factory=dict)

    def of(self, camera: str) -> dict[int, Sighting]:
        """Return the sightings of a camera by frame."""
        return {frame: seen[camera] for frame, seen in self.found.items() if camera in seen}

    def chosen(self, widths: dict[str, int]) -> Sightings:
        """Return still sightings that are spread over the time of each camera. `widths`: pixels of the images by camera."""
        motion = self._motion(widths)
        frames: set[int] = set()
        for camera in widths:
            seen = [frame for frame in sorted(self.found) if camera in self.found[frame]]
            shared = [frame for frame in seen if len(self.found[frame]) > 1]
            frames |= {*_stillest(shared, motion, SHARED), *_stillest(seen, motion, OWN)}
        return Sightings({frame: self.found[frame] for frame in sorted(frames)}, self.others)

    def _motion(self, widths: dict[str, int]) -> dict[int, float]:
        """Return how far the board moves at a frame: the most of all cameras, as a share of the width; 1 if that is unknown."""
        frames, motion = sorted(self.found), {}
        for place, frame in enumerate(frames):
            moved = [
                min((_moved(sighting, self.found[f].get(camera)) for f in _beside(frames, place)), default=np.inf)
                / widths[camera]
                for camera, sighting in self.found[frame].items()
            ]
            motion[frame] = min(max(moved), 1.0)
        return motion


def find_board(videos: FrameSource, names: Sequence[str], board: Board, progress: Progress) -> Sightings:
    """Search the videos of some cameras for a board.

    If no camera shows it, `others` names the dictionary of other markers in some frames.
    """
    frames = np.unique(np.linspace(0, videos.frames - 1, LOOKS).round().astype(int)).tolist()
    progress.stage(f"searching the videos for the board {board.spec}", len(frames))
    sightings = Sightings(others={name: Counter() for name in names})
    for count, frame in enumerate(frames, 1):
        looks = threads.map_parallel(lambda name, at=frame: _look(videos, name, at, board), names)
        seen = {name: look.sighting for name, look in zip(names, looks, strict=True) if look.sighting is not None}
        if seen:
            sightings.found[frame] = seen
        for name, look in zip(names, looks, strict=True):
            sightings.others[name].update([look.other] if look.other else [])
        progress.update(count, sightings=sum(map(len, sightings.found.values())))
    if not sightings.found and board.kind != CHECKERBOARD and not any(sightings.others.values()):
        for frame in frames[len(frames) // 6 :: len(frames) // 3 + 1]:
            for name in names:
                family = family_of_markers(_reduced(videos, name, frame)[0])
                if family is not None:
                    sightings.others[name][f"markers of the dictionary {family}"] = 1
                    return sightings
    return sightings


def _look(videos: FrameSource, name: str, frame: int, board: Board) -> Look:
    if videos.missing(frame, 1, name)[0]:
        return Look(None)
    image, scale = _reduced(videos, name, frame)
    look = board.find(image)
    if look.sighting is None or scale == 1:
        return look
    return Look(Sighting(look.sighting.corners, look.sighting.places * scale))


def _reduced(videos: FrameSource, name: str, frame: int) -> tuple[np.ndarray, float]:
    """Return a frame of a camera, reduced if it is large, and the factor to its own size."""
    image = read_frame(videos, name, frame)
    scale = max(image.shape[:2]) / LONGEST
    if scale <= 1:
        return image, 1.0
    size = round(image.shape[1] / scale), round(image.shape[0] / scale)
    return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX)), image.shape[1] / size[0]


def _stillest(frames: list[int], motion: dict[int, float], count: int) -> list[int]:
    """Return the stillest frame of each of `count` parts of the frames, or all frames if there are fewer."""
    return [min(part.tolist(), key=lambda frame: motion[frame]) for part in np.array_split(frames, count) if len(part)]


def _beside(frames: list[int], place: int) -> list[int]:
    return [frames[n] for n in (place - 1, place + 1) if 0 <= n < len(frames)]


def _moved(one: Sighting, other: Sighting | None) -> float:
    """Return the median distance in pixels between the corners that two sightings share; infinite without any."""
    if other is None:
        return np.inf
    _, here, there = np.intersect1d(one.corners, other.corners, return_indices=True)
    return float(np.median(np.linalg.norm(one.places[here] - other.places[there], axis=1))) if len(here) else np.inf


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
