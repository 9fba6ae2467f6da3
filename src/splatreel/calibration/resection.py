"""Placement of cameras on which the moments disagree, by the points of all moments.

A moment that shows a camera little places it wrongly or not at all. The refined rig has points of all moments. A camera
stands where most of its features lie on the points that they match. Where patterns repeat, it may seem to stand
elsewhere too, with fewer points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from splatreel.calibration.calibration_agreement import CalibratedCamera, CalibratedRig, agreeing, placed_images, rig_of

TIMES = 2.0
"""Minimum number of features of a camera that fit its place, as a multiple of those that fit the next best place."""
AWAY = 6.0
"""Maximum distance of a fitting feature from its point, in pixels of an image 640 pixels wide."""
TRIALS = 1000, 10_000
"""Minimum and maximum number of random trials."""
FEWEST = 6
"""Minimum number of features to compute a place from."""


@dataclass(frozen=True)
class Sighting:
    """N features of a camera, and the points of a model that they match.

    Attributes:
        size: Width and height of the camera's images.
        pixels: Positions of the features, [N, 2] float64.
        points: Numbers of the points, [N].
        places: Positions of the points, [N, 3].
    """

    size: tuple[int, int]
    pixels: np.ndarray
    points: np.ndarray
    places: np.ndarray

    def __getitem__(self, chosen: np.ndarray) -> Sighting:
        return Sighting(self.size, self.pixels[chosen], self.points[chosen], self.places[chosen])

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True)
class Place:
    """Place where a camera may stand."""

    pose: Any
    lens: Any
    fits: np.ndarray

    @property
    def count(self) -> int:
        """Number of features that fit."""
        return int(self.fits.sum())

    def camera(self) -> CalibratedCamera:
        """Return the place as a camera of a rig."""
        matrix = np.asarray(self.pose.matrix())
        focal = self.lens.mean_focal_length() / max(self.lens.width, self.lens.height)
        return CalibratedCamera(matrix[:, :3], -matrix[:, :3].T @ matrix[:, 3], focal, self.count)


class MatchedFeatures:
    """Features of all moments and their matches, from COLMAP's databases."""

    def __init__(self, colmap: ModuleType, databases: Iterable[Path]) -> None:
        self.sizes: dict[str, tuple[int, int]] = {}
        self._pixels: list[dict[str, np.ndarray]] = []
        self._matches: list[dict[tuple[str, str], np.ndarray]] = []
        for database in databases:
            with colmap.Database.open(database) as file:
                names = {image.image_id: Path(image.name).stem for image in file.read_all_images()}
                for image in file.read_all_images():
                    lens = file.read_camera(image.camera_id)
                    self.sizes[names[image.image_id]] = lens.width, lens.height
                self._pixels.append({n: file.read_keypoints(i)[:, :2].astype(np.float32) for i, n in names.items()})
                found: dict[tuple[str, str], np.ndarray] = {}
                for pair, rows in zip(*file.read_all_matches(), strict=True):
                    one, other = (names[number] for number in colmap.pair_id_to_image_pair(pair))
                    found[one, other], found[other, one] = rows, rows[:, ::-1]
                self._matches.append(found)

    def sighting(self, model: Any, name: str) -> Sighting:
        """Return the features of a camera that match features in which other cameras of a model see points."""
        known = {Path(image.name).stem: _points_by_pixel(image) for image in placed_images(model)}
        found: dict[tuple[float, float, int], None] = {}
        for pixels, matches in zip(self._pixels, self._matches, strict=True):
            for other in known:
                for mine, theirs in matches.get((name, other), ()):
                    point = known[other].get(tuple(pixels[other][theirs]))
                    if point is not None:
                        found[*pixels[name][mine], point] = None
        points = np.array([row[2] for row in found], int)
        places = np.array([model.point3D(point).xyz for point in points]).reshape(-1, 3)
        return Sighting(
            self.sizes[name], np.array([row[:2] for row in found], np.float64).reshape(-1, 2), points, places
        )


def place_lost(
    colmap: ModuleType, model: Any, moments: Sequence[CalibratedRig], features: MatchedFeatures, few: int
) -> dict[str, int]:
    """Add cameras that a model lacks, in place, and return the number of points of each added camera.

    A camera is added if at least `few` of its features fit a place. That must be twice as many as fit any other place, or
    a moment must have placed the camera there too.

    Args:
        colmap: Module pycolmap.
        model: Refined model, a pycolmap.Reconstruction.
        moments: Cameras of each moment's model.
        features: Features of all moments.
        few: Minimum number of features.
    """
    added: dict[str, int] = {}
    while True:
        rig, found = rig_of(model), dict[str, tuple[Sighting, Place]]()
        for name in sorted(set(features.sizes) - set(rig)):
            sighting = features.sighting(model, name)
            place, others = find_place(colmap, model, sighting)
            if place is None or place.count < few:
                continue
            confirmed = any(name in agreeing(rig | {name: place.camera()}, moment) for moment in moments)
            if confirmed or place.count >= TIMES * others:
                found[name] = sighting, place
        if not found:
            return added
        name = max(found, key=lambda name: found[name][1].count)
        added[name] = _add(colmap, model, name, *found[name])


def find_place(colmap: ModuleType, model: Any, sighting: Sighting) -> tuple[Place | None, int]:
    """Return the place that most features fit, or None, and the number of features that fit the next best place."""
    lenses = list({image.camera_id: image.camera for image in placed_images(model)}.values())
    best = _resect(colmap, lenses, sighting)
    if best is None:
        return None, 0
    other = _resect(colmap, lenses, sighting[~best.fits])
    return best, 0 if other is None else other.count


def _resect(colmap: ModuleType, lenses: list[Any], sighting: Sighting) -> Place | None:
    """Return the place that most features fit, or None for too few.

    A rig of one lens has that one. Otherwise the focal length is found, and the distortion is the median of the others'.
    """
    if len(sighting) < FEWEST:
        return None
    lens, is_known = lenses[0], len(lenses) == 1
    width, height = sighting.size
    if not is_known:
        focal, radial = np.median(
            [[lens.params[0] / max(lens.width, lens.height), lens.params[3]] for lens in lenses], 0
        )
        parameters = [focal * max(width, height), width / 2, height / 2, radial]
        lens = colmap.Camera(model="SIMPLE_RADIAL", width=width, height=height, params=parameters)
    estimation, refinement = colmap.AbsolutePoseEstimationOptions(), colmap.AbsolutePoseRefinementOptions()
    estimation.estimate_focal_length = refinement.refine_focal_length = not is_known
    estimation.ransac.max_error = AWAY / 640 * max(width, height)
    estimation.ransac.min_num_trials, estimation.ransac.max_num_trials = TRIALS
    estimation.ransac.random_seed = 1
    best = colmap.estimate_and_refine_absolute_pose(sighting.pixels, sighting.places, lens, estimation, refinement)
    return None if best is None else Place(best["cam_from_world"], lens, np.asarray(best["inlier_mask"], bool))


def _add(colmap: ModuleType, model: Any, name: str, sighting: Sighting, place: Place) -> int:
    """Add a camera and its sight of points to a model, and return the number of points."""
    seen = sighting[place.fits]
    _, some = np.unique(seen.points, return_index=True)
    seen = seen[some]
    number = max(image.image_id for image in model.images.values()) + 1
    if len({image.camera_id for image in placed_images(model)}) == 1:
        lens = placed_images(model)[0].camera_id
    else:
        lens = place.lens.camera_id = max(model.cameras) + 1
        model.add_camera_with_trivial_rig(place.lens)
    image = colmap.Image(name=f"{name}.png", keypoints=seen.pixels, camera_id=lens, image_id=number)
    model.add_image_with_trivial_frame(image, place.pose)
    for row, point in enumerate(seen.points):
        model.add_observation(point, colmap.TrackElement(number, row))
    return len(seen)


def _points_by_pixel(image: Any) -> dict[tuple[float, float], int]:
    """Return the numbers of the points that an image sees by position, with the precision of the database."""
    seen = [point for point in image.points2D if point.has_point3D()]
    return {tuple(np.asarray(point.xy, np.float32)): point.point3D_id for point in seen}
