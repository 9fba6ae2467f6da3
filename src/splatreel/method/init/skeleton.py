"""Skeletons of people: landmarks of all cameras, triangulated, and the capsules around their bones."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.method.images.people import LANDMARKS, People, squares_around, without_repeats
from splatreel.method.init.layout import up_angles
from splatreel.scene.camera import Camera
from splatreel.scene.volumes import Volume, in_image

EARS = (7, 8)
SHOULDERS, ELBOWS, WRISTS = (11, 12), (13, 14), (15, 16)
HANDS = ((17, 19, 21), (18, 20, 22))
HIPS, KNEES, ANKLES, HEELS, TOES = (23, 24), (25, 26), (27, 28), (29, 30), (31, 32)
MAIN = [*SHOULDERS, *ELBOWS, *WRISTS, *HIPS, *KNEES, *ANKLES]
"""Landmarks by which the same person is recognized in two images."""
MIRRORED = [0, 4, 5, 6, 1, 2, 3, 8, 7, 10, 9, *np.arange(11, 33).reshape(-1, 2)[:, ::-1].ravel().tolist()]
"""Landmark of the other side, for each landmark. Networks confuse left and right where they see a back."""
ALIKE, AGREEING = 0.06, 0.05
"""Largest distance of a person's and of one landmark's projections from what an image shows, as shares of the square's side."""
NARROW = 0.94
"""Cosine of the angle between two rays above which, or below whose negative, they say too little about a depth."""
TORSO, THIGH, SHIN = 0.29, 0.245, 0.246
"""Lengths of parts as shares of the body's height (Winter, "Biomechanics and Motor Control of Human Movement")."""


@dataclass(frozen=True)
class Skeleton:
    """A person's landmarks.

    Attributes:
        points: [33, 3] world units; NaN where the cameras do not agree.
        height: Height of the body as its parts tell it, world units.
    """

    points: np.ndarray
    height: float


@dataclass(frozen=True)
class Seen:
    """Landmarks of a person in the image of a camera, by number; `points` [33, 2] and `visible` [33] may be mirrored."""

    camera: int
    points: np.ndarray
    visible: np.ndarray
    side: float

    def mirrored(self) -> Seen:
        """Return the landmarks with left and right exchanged."""
        return Seen(self.camera, self.points[MIRRORED], self.visible[MIRRORED], self.side)


def find_skeletons(
    cameras: Sequence[Camera], images: np.ndarray, masks: np.ndarray, hull: Volume, people: People
) -> list[Skeleton]:
    """Return the skeletons of the people that at least three cameras show, or two if there are only two.

    Args:
        cameras: C cameras.
        images: [C, H, W, 3] uint8.
        masks: [C, H, W] bool, pixels of the subject.
        hull: Volume that all landmarks are in.
        people: Networks.
    """
    angles = up_angles(cameras)

    def look(c: int) -> list[Seen]:
        squares = without_repeats(people.find(images[c], angles[c]), squares_around(masks[c]))
        found = [people.landmarks(images[c], square) for square in squares]
        return [Seen(c, each.points, each.visible, each.side) for each in found if each is not None]

    seen = [each for found in threads.map_parallel(look, range(len(cameras))) for each in found]
    return match_people(cameras, seen, hull)


def match_people(cameras: Sequence[Camera], seen: Sequence[Seen], hull: Volume) -> list[Skeleton]:
    """Return the skeletons of what at least three cameras show in agreement, or two if there are only two.

    Each pair of images of a person gives a skeleton. The one that most other cameras confirm comes first, and takes its images.
    """
    projections = np.stack([camera.K @ camera.viewmat[:3] for camera in cameras]).astype(np.float64)
    centers = np.stack([camera.center for camera in cameras]).astype(np.float64)
    left, found = list(range(len(seen))), []
    needed = min(3, len(cameras))
    while True:
        best: list[tuple[int, Seen]] = []
        worst = np.inf
        for i, j in itertools.combinations(left, 2):
            if seen[i].camera == seen[j].camera:
                continue
            for other in (seen[j], seen[j].mirrored()):
                group, error = _grown(projections, seen, left, [(i, seen[i]), (j, other)])
                if len(group) >= needed and (len(group), -error) > (len(best), -worst):
                    best, worst = group, error
        if not best:
            return found
        left = [k for k in left if k not in {number for number, _ in best}]
        if (skeleton := _triangulated(projections, centers, [each for _, each in best], hull)) is not None:
            found.append(skeleton)


def _grown(
    projections: np.ndarray, seen: Sequence[Seen], left: Sequence[int], pair: list[tuple[int, Seen]]
) -> tuple[list[tuple[int, Seen]], float]:
    """Return a pair of images of a person with those of other cameras that agree, and their mean error."""
    group = list(pair)
    points = _intersect(projections, [each for _, each in pair], MAIN)
    errors = [_error(projections, points, each) for _, each in pair]
    if max(errors) > ALIKE:
        return [], np.inf
    for camera in sorted({seen[k].camera for k in left} - {each.camera for _, each in pair}):
        best = min(
            (
                (_error(projections, points, each), k, each)
                for k in left
                if seen[k].camera == camera
                for each in (seen[k], seen[k].mirrored())
            ),
            key=lambda entry: entry[0],
        )
        if best[0] < ALIKE:
            group.append(best[1:])
            errors.append(best[0])
            points = _intersect(projections, [each for _, each in group], MAIN)
    return group, float(np.mean(errors))


def _intersect(projections: np.ndarray, seen: Sequence[Seen], landmarks: Sequence[int]) -> np.ndarray:
    """Return the points [L, 3] that best explain landmarks of all images of a person."""
    chosen = projections[[each.camera for each in seen]]
    pixels = np.stack([each.points[landmarks] for each in seen])  # [V, L, 2]
    weight = np.stack([each.visible[landmarks] for each in seen]) + 0.1
    rows = pixels[..., None] * chosen[:, None, None, 2] - chosen[:, None, :2]  # [V, L, 2, 4]
    rows *= (weight / np.array([each.side for each in seen])[:, None])[..., None, None]
    systems = np.moveaxis(rows, 1, 0).reshape(len(landmarks), -1, 4)
    scale = np.linalg.norm(systems, axis=(1, 2), keepdims=True)
    last = np.linalg.svd(systems / np.maximum(scale, 1e-12))[2][:, -1]
    return last[:, :3] / np.where(np.abs(last[:, 3:]) < 1e-12, 1e-12, last[:, 3:])


def _distances(projections: np.ndarray, points: np.ndarray, seen: Seen, landmarks: Sequence[int]) -> np.ndarray:
    """Return the distance [L] of projected points [L, 3] from the landmarks of an image, as a share of the square's side."""
    projected = points @ projections[seen.camera, :, :3].T + projections[seen.camera, :, 3]
    depth = projected[:, 2]
    pixels = projected[:, :2] / np.where(depth > 0, depth, np.nan)[:, None]
    away = np.linalg.norm(pixels - seen.points[landmarks], axis=1) / seen.side
    return np.where(np.isfinite(away), away, np.inf)


def _error(projections: np.ndarray, points: np.ndarray, seen: Seen) -> float:
    return float(np.median(_distances(projections, points, seen, MAIN)))


def _triangulated(projections: np.ndarray, centers: np.ndarray, seen: Sequence[Seen], hull: Volume) -> Skeleton | None:
    """Return the skeleton of a person. Landmarks that fewer than two images agree on, or that are outside of the hull, are unknown."""
    points = np.full((LANDMARKS, 3), np.nan)
    for landmark in range(LANDMARKS):
        best: tuple[int, float, np.ndarray] | None = None
        for pair in itertools.combinations(seen, 2):
            (point,) = _intersect(projections, pair, [landmark])
            first, second = (point - centers[each.camera] for each in pair)
            cosine = first @ second / max(float(np.linalg.norm(first) * np.linalg.norm(second)), 1e-12)
            if abs(cosine) > NARROW:
                continue
            errors = np.array([_distances(projections, point[None], each, [landmark])[0] for each in seen])
            agree = errors < AGREEING
            if agree.sum() >= 2 and (best is None or (int(agree.sum()), -errors[agree].mean()) > best[:2]):
                chosen = [each for each, kept in zip(seen, agree, strict=True) if kept]
                best = int(agree.sum()), -float(errors[agree].mean()), _intersect(projections, chosen, [landmark])[0]
        if best is not None and hull.contains(best[2][None])[0]:
            points[landmark] = best[2]
    height = _height(points)
    return None if height is None else Skeleton(points, height)


def _height(points: np.ndarray) -> float | None:
    """Return the height of a body by the lengths of its parts; None if none is known."""
    torso = points[list(SHOULDERS)].mean(0) - points[list(HIPS)].mean(0)
    parts = [(torso, TORSO)]
    for hip, knee, ankle in zip(HIPS, KNEES, ANKLES, strict=True):
        parts += [(points[hip] - points[knee], THIGH), (points[knee] - points[ankle], SHIN)]
    heights = [float(np.linalg.norm(part)) / share for part, share in parts if np.isfinite(part).all()]
    return float(np.median(heights)) if heights else None


@dataclass(frozen=True)
class Capsules:
    """Places within a radius of line segments. starts, ends: [B, 3]. radii: [B] world units."""

    starts: np.ndarray
    ends: np.ndarray
    radii: np.ndarray

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Return the distance [N] of points [N, 3] from the nearest surface, negative inside."""
        found = np.full(len(points), np.inf, np.float32)
        for start, end, radius in zip(self.starts, self.ends, self.radii, strict=True):
            bone = end - start
            along = np.clip((points - start) @ bone / max(float(bone @ bone), 1e-12), 0, 1)
            away = np.linalg.norm(points - start - along[:, None] * bone, axis=1) - radius
            np.minimum(found, away, out=found, casting="same_kind")
        return found


HEAD, NECK, TRUNK, SIDE = 0.062, 0.035, 0.07, 0.055
ARM, FOREARM, HAND, LEG, LOWER_LEG, FOOT = 0.027, 0.023, 0.022, 0.045, 0.032, 0.024
"""Usual radii of capsules, as shares of the body's height."""
THINNEST, THICKEST = 0.8, 1.8
"""Smallest and largest radius relative to the usual one. Clothes are wider than bodies. A landmark beside its bone touches a border."""
SAMPLES = 5
"""Places along a bone at which its radius is measured."""


def capsules(skeleton: Skeleton, cameras: Sequence[Camera], masks: np.ndarray) -> Capsules:
    """Return capsules along the known bones, as wide as all masks [C, H, W] bool allow, within bounds."""
    bones = _bones(skeleton.points)
    starts, ends = (np.array([bone[k] for bone in bones]).reshape(-1, 3) for k in (0, 1))
    usual = np.array([bone[2] for bone in bones]) * skeleton.height
    places = starts[:, None] + np.linspace(0, 1, SAMPLES)[:, None] * (ends - starts)[:, None]
    room = np.full(places.shape[:2], np.inf)
    for camera, mask in zip(cameras, masks, strict=True):
        inner = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
        inside, pixels, depth = in_image(places, camera, 0.0)
        column, row = np.moveaxis(np.where(inside[..., None], pixels, 0).astype(int), -1, 0)
        room = np.where(inside, np.minimum(room, inner[row, column] * depth / camera.K[0, 0]), room)
    radii = np.clip(np.median(room, 1), THINNEST * usual, THICKEST * usual)
    return Capsules(starts, ends, radii)


def _bones(points: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Return the known bones: their ends, and their usual radius as a share of the body's height."""
    shoulders, hips, head = (points[list(ids)].mean(0) for ids in (SHOULDERS, HIPS, EARS))
    bones = [
        (head, head, HEAD),
        (shoulders, head, NECK),
        (shoulders, hips, TRUNK),
        (points[SHOULDERS[0]], points[SHOULDERS[1]], SIDE),
        (points[HIPS[0]], points[HIPS[1]], SIDE),
    ]
    for side in (0, 1):
        at = [points[pair[side]] for pair in (SHOULDERS, ELBOWS, WRISTS, HIPS, KNEES, ANKLES, HEELS, TOES)]
        shoulder, elbow, wrist, hip, knee, ankle, heel, toe = at
        hand = points[list(HANDS[side])].mean(0)
        bones += [
            (shoulder, hip, SIDE),
            (shoulder, elbow, ARM),
            (elbow, wrist, FOREARM),
            (wrist, wrist + 1.3 * (hand - wrist), HAND),
            (hip, knee, LEG),
            (knee, ankle, LOWER_LEG),
            (ankle, heel, FOOT),
            (heel, toe, FOOT),
        ]
    return [bone for bone in bones if np.isfinite(bone[0]).all() and np.isfinite(bone[1]).all()]
