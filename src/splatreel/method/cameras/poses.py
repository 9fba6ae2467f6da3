"""Check of the cameras' poses against the images, and correction of poses that are wrong (beyond the paper).

Two cameras that agree on a place predict where a third camera shows it. If a slightly different pose of the third camera would make
most predictions right, the camera was moved after its calibration: its pose is corrected. A camera whose features hardly ever lie on
the others' epipolar lines is somewhere else, or has the video of another camera. A camera that looks from a place where no other does
has little in common with the others at any pose. That is not evidence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.base.errors import ReconstructionError
from splatreel.capture.pose_checks import inverted, with_opengl_axes
from splatreel.method.init.triangulate import (
    Features,
    detect,
    epipolar_lines,
    intersect,
    line_distances,
    match,
    neighbor_pairs,
    reprojection_errors,
    separation,
)
from splatreel.scene.camera import Camera, focus_point, project, unproject

NEIGHBORS = 6
SEARCH_WIDTHS = 0.03, 0.015, 0.008
"""Distances from epipolar lines within which features are matched, in the rounds of a correction, as shares of the image width. No pose
is corrected by more than the first."""
MATCH_PIXELS = 0.7
"""Largest error in pixels of a match that is believed."""
NARROW = 3.0
"""Degrees between two cameras' rays to a place, below which they do not determine its distance."""
ROUNDS = 25
MOVED = 0.7
"""Median error in pixels of a camera's features, above which the camera was moved."""
PLENTY = 160
"""Number of features that suffices for this decision. Half as many must be off by twice as much, as for a dancer in front of plain
walls."""
GAIN = 1.4
"""Factor by which the corrected pose must increase the number of places that are shown where they are."""
FEWEST_POINTS_AND_MATCHES = 80, 200
"""Smallest number of places to estimate a pose from, and of matches to find a stranger by."""
CHANCE = 1.6
"""Matches on their epipolar lines, as a multiple of those by chance, in any camera that sees what the others see."""
WIDE = 60.0
"""Degrees between two cameras' directions, above which features hardly match at any pose."""
ALIKE = 2.0, 50
"""Matches on their epipolar lines, as a multiple of those by chance, and their number, where two cameras show the same things."""
POSE_STEP = 1e-3
"""Unit of the six unknowns of a pose: radians, and a share of the distance between cameras."""
BEHIND = 1e6
"""Pixel coordinate that stands for a place behind a camera."""
FREE = 0.1
"""Weight of an unchanged pose, for each unknown."""

Pair = tuple[int, int]


@dataclass(frozen=True)
class CorrectedPose:
    """A camera whose pose was corrected.

    Attributes:
        camera: The camera at the corrected pose.
        pixels: Median shift of its image by the correction, for places as far away as most cameras look.
    """

    camera: Camera
    pixels: float


@dataclass(frozen=True)
class PoseFindings:
    """Result of the inspection of all poses. Cameras are named by index.

    Attributes:
        corrected: Cameras whose poses were corrected.
        strangers: Cameras that do not show what their neighbors show.
        doubtful: All cameras that seem wrong, if there are too many to tell which ones are right. The two above are then empty.
        unchecked: Cameras that overlap the others too little for their poses to be verified.
        convention: Convention that all poses follow instead of the required one, if they do.
    """

    corrected: dict[int, CorrectedPose]
    strangers: list[int]
    doubtful: list[int]
    unchecked: list[int] = field(default_factory=list)
    convention: str | None = None

    def refuse(self, origin: str) -> None:
        """Raise a `ReconstructionError` if the poses follow another convention. `origin` names the file that they come from."""
        if self.convention is not None:
            raise ReconstructionError(
                f"{origin}: the poses do not fit the images, but would if they were {self.convention}. Convert them to matrices of "
                "world to camera in OpenCV's axes: x right, y down, z forward."
            )

    def repairs(self, names: list[str]) -> list[str]:
        """Return a sentence about each camera that was corrected."""
        return [
            f"{names[number]} was moved after its calibration, by {corrected.pixels:.1f} pixels of its image: its pose is corrected"
            for number, corrected in self.corrected.items()
        ]

    def doubts(self, names: list[str]) -> list[str]:
        """Return sentences about cameras whose poses could not be corrected or verified."""
        wrong = "does not show at its pose what its neighbors show, and is left out: check its pose and its video"
        sentences = [f"{names[number]} {wrong}" for number in self.strangers]
        if self.doubtful:
            doubtful = ", ".join(names[number] for number in self.doubtful)
            sentences.append(
                f"the poses or lenses of {doubtful} do not fit each other, too many to be corrected: calibrate again"
            )
        if len(self.unchecked) == len(names):
            sentences.append("the cameras show too little in common to check their poses: they are used unchecked")
        elif self.unchecked:
            unchecked = ", ".join(names[number] for number in self.unchecked)
            sentences.append(
                f"{unchecked}: too little in common with the other cameras to check the pose, which is used unchecked"
            )
        return sentences


@dataclass(frozen=True)
class PoseEstimate:
    """The pose at which a camera would show most places where they are.

    Attributes:
        gain: Number of places that it shows where they are, as a multiple of that at the given pose.
        moved: Median shift in pixels of these places by the new pose.
        features: Number of features that the estimate is based on.
    """

    camera: Camera
    gain: float = 1.0
    moved: float = 0.0
    features: int = 0

    @property
    def wrong(self) -> bool:
        """True if the given pose is clearly wrong."""
        return self.gain > GAIN and self.moved > MOVED * max(1.0, PLENTY / max(self.features, 1))


class _PoseCheck:
    """Features of all cameras at some moments, and their matches."""

    def __init__(self, cameras: list[Camera], frames: np.ndarray) -> None:
        self.cameras = list(cameras)
        self.pairs = neighbor_pairs(cameras, NEIGHBORS)
        self.apart = separation(cameras)
        self.chance = MATCH_PIXELS / (SEARCH_WIDTHS[0] * cameras[0].width)
        forwards = np.stack([camera.forward for camera in cameras])
        self.narrow = forwards @ forwards.T > np.cos(np.radians(WIDE))
        self.features = [threads.map_parallel(detect, images) for images in frames]
        self.matches = self._match_all(self.pairs, SEARCH_WIDTHS[0])
        self._near: dict[Pair, np.ndarray] = {}

    def correct(self, number: int) -> None:
        """Correct a camera's pose in rounds of smaller and smaller search distances."""
        around = [pair for pair in self.pairs if number in pair]
        for reach in SEARCH_WIDTHS:
            self.matches |= self._match_all(around, reach)
            self.cameras[number] = self.estimate_pose(number).camera
        self.matches |= self._match_all(around, SEARCH_WIDTHS[0])
        self._near = {pair: near for pair, near in self._near.items() if pair not in around}

    def _match_all(self, pairs: list[Pair], reach: float) -> dict[Pair, list[np.ndarray]]:
        """Return the matches of each pair of cameras, see `_match`."""
        return dict(zip(pairs, threads.map_parallel(lambda pair: self._match(pair, reach), pairs), strict=True))

    def _match(self, pair: Pair, reach: float) -> list[np.ndarray]:
        """Return matches [M, 2] of two cameras at each moment, as indices of features. `reach` is the search distance."""
        (a, b), cameras = pair, self.cameras
        return [match(cameras[a], cameras[b], seen[a], seen[b], reach * cameras[a].width) for seen in self.features]

    def is_stranger(self, number: int) -> bool:
        """Return True if a camera's features lie on epipolar lines hardly more often than random features in reach."""
        near = self._on_lines(self._comparable(number))
        return len(near) >= FEWEST_POINTS_AND_MATCHES[1] and near.mean() < CHANCE * self.chance

    def is_unverifiable(self, number: int) -> bool:
        """Return True if the camera overlaps the others too little for its pose to be verified."""
        near = self._on_lines([pair for pair in self.pairs if number in pair])
        return len(self._on_lines(self._comparable(number))) < FEWEST_POINTS_AND_MATCHES[1] and not self._alike(near)

    def _comparable(self, number: int) -> list[Pair]:
        """Return pairs of the camera that would match if all poses were right: other pairs with views as different do match."""
        others = [pair for pair in self.pairs if number not in pair and self._alike(self._on_lines([pair]))]
        most = max((self.apart[pair] for pair in others), default=0.0)
        return [pair for pair in self.pairs if number in pair and self.narrow[pair] and self.apart[pair] <= most]

    def _alike(self, near: np.ndarray) -> bool:
        return len(near) >= ALIKE[1] and near.mean() > ALIKE[0] * self.chance

    def _on_lines(self, pairs: list[Pair]) -> np.ndarray:
        """Return [M] bool: which matches of pairs of cameras lie on their epipolar lines."""
        for a, b in pairs:
            if (a, b) in self._near:
                continue
            off = [np.zeros(0)]
            for seen, found in zip(self.features, self.matches[a, b], strict=True):
                lines = epipolar_lines(self.cameras[a], self.cameras[b], seen[a].pixels[found[:, 0]])
                off.append(line_distances(lines, seen[b].pixels[found[:, 1]]))
            self._near[a, b] = np.abs(np.concatenate(off)) < MATCH_PIXELS
        return np.concatenate([np.zeros(0, bool), *(self._near[pair] for pair in pairs)])

    def estimate_pose(self, number: int) -> PoseEstimate:
        """Return the pose at which a camera would show most places where two others agree that they are."""
        camera = self.cameras[number]
        places, pixels = self._places(number)
        if len(places) < FEWEST_POINTS_AND_MATCHES[0]:
            return PoseEstimate(camera)
        far = [np.linalg.norm(camera.center - other.center) for other in self.cameras if other is not camera]
        units = POSE_STEP * np.repeat([1, float(np.median(far))], 3)

        def off(change: np.ndarray) -> np.ndarray:
            shown, _ = project(_moved(camera, units * change), places)
            return (np.nan_to_num(shown, nan=BEHIND) - pixels).ravel()

        before = off(np.zeros(6))
        slopes = np.stack([(off(unit) - off(-unit)) / 2 for unit in np.eye(6)], 1)
        change = _solve_robustly(before, slopes)
        step = (slopes @ change).reshape(-1, 2)
        before = before.reshape(-1, 2)
        at_once, believed = (np.linalg.norm(error, axis=1) < MATCH_PIXELS for error in (before, before + step))
        moved = float(np.median(np.linalg.norm(step[believed], axis=1))) if believed.any() else 0.0
        gain, features = believed.sum() / max(at_once.sum(), 1), len(np.unique(pixels, axis=0))
        return PoseEstimate(_moved(camera, units * change), gain, moved, features)

    def _places(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return places [M, 3] that two other cameras agree on, and pixels [M, 2] of the camera's own features that match both."""
        projections = np.stack([c.K.astype(np.float64) @ c.viewmat[:3].astype(np.float64) for c in self.cameras])
        centers = np.stack([camera.center for camera in self.cameras]).astype(np.float64)
        places, pixels = [np.zeros((0, 3))], [np.zeros((0, 2))]
        for moment, seen in enumerate(self.features):
            own, others, there = self._shared(number, moment)
            couples = _pairs_of_equals(own)
            track = np.repeat(np.arange(len(couples)), 2)
            views, spots = others[couples.ravel()], there[couples.ravel()]
            found = intersect(projections[views], spots, track, len(couples))
            error = reprojection_errors(projections, found[track], views, spots).reshape(-1, 2).max(1)
            rays = found[:, None] - centers[views.reshape(-1, 2)]
            rays /= np.maximum(np.linalg.norm(rays, axis=2, keepdims=True), 1e-12)
            sure = (error < MATCH_PIXELS) & ((rays[:, 0] * rays[:, 1]).sum(1) < np.cos(np.radians(NARROW)))
            places.append(found[sure])
            pixels.append(seen[number].pixels[own[couples[sure, 0]]])
        return np.concatenate(places), np.concatenate(pixels)

    def _shared(self, number: int, moment: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return features [E] of a camera, sorted, the cameras [E] that match them, and their pixels [E, 2] in those."""
        own, others, there = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros((0, 2))]
        for pair in self.pairs:
            if number in pair:
                side, found = pair.index(number), self.matches[pair][moment]
                other = pair[1 - side]
                own.append(found[:, side])
                others.append(np.full(len(found), other))
                there.append(self.features[moment][other].pixels[found[:, 1 - side]])
        order = np.argsort(np.concatenate(own), kind="stable")
        return np.concatenate(own)[order], np.concatenate(others)[order], np.concatenate(there)[order]


def inspect_poses(cameras: list[Camera], frames: np.ndarray) -> PoseFindings:
    """Find cameras with wrong poses, and correct them. The worst one comes first; then all others are estimated again.

    `frames` [T, C, H, W, 3] are of several moments, so that a moving thing is not taken for a moving camera.
    """
    check, corrected = _PoseCheck(cameras, frames), set[int]()
    if meant := recognize_convention(
        cameras, check.features[0], {pair: found[0] for pair, found in check.matches.items()}
    ):
        return PoseFindings({}, [], [], [], meant)
    numbers = range(len(cameras))
    strangers: list[int] = []
    unchecked: list[int] = []
    for _ in numbers:
        estimates = dict(zip(numbers, threads.map_parallel(check.estimate_pose, numbers), strict=True))
        unverifiable = [c for c in numbers if check.is_unverifiable(c)]
        wrong = [c for c in numbers if estimates[c].wrong and c not in unverifiable]
        strangers = [c for c in numbers if c not in wrong and check.is_stranger(c)]
        judged = [c for c in numbers if estimates[c].features]
        unchecked = [c for c in unverifiable if c not in corrected]
        suspects = sorted({*corrected, *wrong, *strangers})
        many = bool(suspects) and 3 * len(suspects) >= len(cameras)
        if many and 2 * len(judged) >= len(cameras):
            return PoseFindings({}, [], suspects)
        if many or 2 * len(unchecked) > len(cameras):
            lost = sorted({*suspects, *unchecked})
            misfit = show_the_same(check.features[0], neighbor_pairs(cameras, 1))
            return PoseFindings({}, [], lost) if misfit else PoseFindings({}, [], [], lost)
        if not wrong:
            break
        worst = max(wrong, key=lambda c: estimates[c].gain)
        check.correct(worst)
        corrected.add(worst)
    focus = focus_point(cameras)
    pixels = {c: _median_shift(cameras[c], check.cameras[c], focus) for c in corrected if c not in strangers}
    return PoseFindings(
        {c: CorrectedPose(check.cameras[c], off) for c, off in pixels.items()}, strangers, [], unchecked
    )


def _pairs_of_equals(own: np.ndarray) -> np.ndarray:
    """Return pairs [P, 2] of indices of equal entries in a sorted array [E]."""
    couples, gap = [np.zeros((0, 2), int)], 1
    while len(same := np.flatnonzero(own[:-gap] == own[gap:])):
        couples.append(np.stack([same, same + gap], 1))
        gap += 1
    return np.concatenate(couples)


def _solve_robustly(off: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Return the change [6] that brings most of off [2 M] + slopes [2 M, 6] change near zero.

    Weights are those of Geman and McClure, with a tolerance that shrinks from round to round.
    """
    change = np.zeros(6)
    for close in np.geomspace(max(np.percentile(np.abs(off), 75), MATCH_PIXELS), MATCH_PIXELS, ROUNDS):
        squares = np.square((off + slopes @ change).reshape(-1, 2)).sum(1).repeat(2)
        weighed = slopes * np.square(close**2 / (squares + close**2))[:, None]
        change = np.linalg.solve(weighed.T @ slopes + FREE * np.eye(6), -weighed.T @ off)
    return change


def _moved(camera: Camera, change: np.ndarray) -> Camera:
    """Return a camera turned by a rotation vector and shifted, [6], both in its own axes."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = cv2.Rodrigues(change[:3])[0], change[3:]
    return replace(camera, viewmat=(motion @ camera.viewmat.astype(np.float64)).astype(np.float32))


def _median_shift(camera: Camera, moved: Camera, focus: np.ndarray) -> float:
    """Return the median distance in pixels between the images of two cameras, for places as far from the first as focus [3]."""
    depth = abs(float(camera.forward @ (focus - camera.center)))
    places = unproject(camera.resized(5, 5), np.full((5, 5), depth))
    return float(np.median(np.linalg.norm(project(moved, places)[0] - project(camera, places)[0], axis=-1)))


SEARCH_WIDTH, FITTING_PIXELS = 0.03, 0.7
"""Distance from epipolar lines within which features are matched, as a share of the image width; and their distance in pixels where
poses are right."""
FITS = 0.2
"""Share of the matches of nearest cameras that fit, above which the poses are believed."""
CLEAR_RATIO, FEWEST_MATCHES = 3.0, 60
"""Smallest number of fitting matches, as a multiple of those by chance and at the given poses, and as a count."""
SIMILAR, TOLERANCE, ENOUGH_MATCHES = 0.8, 1.0, 16
"""Largest ratio of the best to the second best descriptor distance; largest error in pixels; and matches that two images of the same
things have. One in eight pairs of images of different things has as many."""
Matches = dict[tuple[int, int], np.ndarray]
"""Indices of features [M, 2] by pairs of cameras."""

CONVENTIONS: dict[str, Callable[[list[Camera]], list[Camera]]] = {
    "camera to world": inverted,
    "world to camera in OpenGL's axes (y up, z backwards)": with_opengl_axes,
    "camera to world in OpenGL's axes (y up, z backwards)": lambda cameras: with_opengl_axes(inverted(cameras)),
}
"""Functions from the given cameras to the intended ones, by the convention of the file."""


def recognize_convention(cameras: list[Camera], features: list[Features], matches: Matches) -> str | None:
    """Return the name of the convention that the poses follow, if the features fit it and do not fit the required one.

    Some files hold camera-to-world matrices, or OpenGL's axes. Such matrices look like any others, but features of neighboring
    cameras then lie off their epipolar lines, or behind the cameras.
    """
    said, _ = share_of_fitting(cameras, features, matches)
    if said > FITS:
        return None
    best, share, count = None, 0.0, 0
    for name, meant in CONVENTIONS.items():
        found, many = share_of_fitting(stood := meant(cameras), features, match_nearest(stood, features))
        if found > share:
            best, share, count = name, found, many
    chance = FITTING_PIXELS / (SEARCH_WIDTH * cameras[0].width)
    return (
        best
        if count >= FEWEST_MATCHES and share > CLEAR_RATIO * max(said, chance / 2) and share > 1.5 * chance
        else None
    )


def show_the_same(features: list[Features], pairs: list[tuple[int, int]]) -> bool:
    """Return True if most pairs of images show the same things, at any poses."""
    return 2 * sum(_images_match(features[i], features[j]) for i, j in pairs) > len(pairs)


def _images_match(a: Features, b: Features) -> bool:
    """Return True if mutual best matches fit some epipolar geometry."""
    if min(len(a.pixels), len(b.pixels)) < ENOUGH_MATCHES:
        return False
    similarity = a.descriptors @ b.descriptors.T
    rows, best = np.arange(len(similarity)), similarity.argmax(1)
    mutual, first = similarity.argmax(0)[best] == rows, similarity[rows, best]
    similarity[rows, best] = -1
    apart, next_apart = (np.sqrt(np.maximum(2 - 2 * alike, 0)) for alike in (first, similarity.max(1)))
    found = mutual & (apart < SIMILAR * next_apart)
    if found.sum() < ENOUGH_MATCHES:
        return False
    here, there = a.pixels[found], b.pixels[best[found]]
    fits = cv2.findFundamentalMat(here, there, cv2.USAC_MAGSAC, TOLERANCE, 0.999, 2000)[1]
    return fits is not None and int(fits.sum()) >= ENOUGH_MATCHES


def match_nearest(cameras: list[Camera], features: list[Features]) -> Matches:
    """Match the features of each camera and its nearest one."""
    return {
        (i, j): match(cameras[i], cameras[j], features[i], features[j], SEARCH_WIDTH * cameras[i].width)
        for i, j in neighbor_pairs(cameras, 1)
    }


def share_of_fitting(cameras: list[Camera], features: list[Features], matches: Matches) -> tuple[float, int]:
    """Return the share and the number of matches of nearest cameras that lie on epipolar lines and in front of both cameras."""
    total, fits = 0, 0
    for i, j in neighbor_pairs(cameras, 1):
        a, b, found = cameras[i], cameras[j], matches[i, j]
        there, here = features[j].pixels[found[:, 1]], features[i].pixels[found[:, 0]]
        near = np.abs(line_distances(epipolar_lines(a, b, here), there)) < FITTING_PIXELS
        total += len(found)
        fits += int(_in_front(a, b, here[near], there[near]).sum())
    return fits / max(total, 1), fits


def _in_front(a: Camera, b: Camera, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return [M] bool: which places, seen by two cameras at pixels [M, 2], are in front of both."""
    projections = np.stack([c.K.astype(np.float64) @ c.viewmat[:3].astype(np.float64) for c in (a, b)])
    count = len(here)
    both = np.tile(np.arange(2), count)
    pixels = np.stack([here, there], 1).reshape(-1, 2)
    places = intersect(projections[both], pixels, np.repeat(np.arange(count), 2), count)
    depths = [places @ c.viewmat[2, :3].astype(np.float64) + float(c.viewmat[2, 3]) for c in (a, b)]
    return (depths[0] > 0) & (depths[1] > 0)
