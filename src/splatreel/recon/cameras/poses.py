"""Cameras that are not where they are said to be, and such as show something else (beyond the paper).

What two other cameras agree on lies at a place that a third one must show where it does. If it would do so only turned and moved a
little, it was touched after its calibration: all others see the scene twice until it is put right. A camera whose features hardly ever
lie on the others' epipolar lines is somewhere else, or its video is another's; but one that looks from where no other does has little
in common with them wherever it stands, which is no evidence.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np

from splatreel import threads
from splatreel.recon.cameras.findings import Findings, Mended
from splatreel.recon.cameras.readings import misread, related
from splatreel.recon.init.features import detect, epipolar_lines, line_distances, match
from splatreel.recon.init.planesweep import project, unproject
from splatreel.recon.init.triangulate import intersect, neighbor_pairs, reprojection_errors, separation
from splatreel.scene.camera import Camera, focus_point

NEIGHBORS = 6
SEARCH_WIDTHS = 0.03, 0.015, 0.008
"""Of the picture's width: how far off their lines features are looked for, from round to round; nobody is put right by more."""
MATCH_PIXELS = 0.7
"""Pixels by which what is believed may be off."""
NARROW = 3.0
"""Degrees between two cameras' views of a place, below which they do not know how far it is."""
ROUNDS = 25
MOVED = 0.7
"""Pixels that what a camera shows must be off, in the median, for it to be touched."""
PLENTY = 160
"""Features that are enough to tell that; of half as many, on a dancer before plain walls, twice as far off is asked."""
GAIN = 1.4
"""Times as many places must be shown where they are then."""
FEWEST_POINTS_AND_MATCHES = 80, 200
"""Places by which a camera is judged, and matches by which it is a stranger."""
CHANCE = 1.6
"""Times as many matches as by chance that are on their lines in any camera that sees what the others do."""
WIDE = 60.0
"""Degrees between two cameras' directions, from which on features hardly match, wherever they stand."""
ALIKE = 2.0, 50
"""Times as many matches as by chance that are on their lines, and of how many, where two cameras show the same things."""
POSE_STEP = 1e-3
"""Radians, and of the cameras' distance from each other: what six unknowns of a pose are counted in."""
BEHIND = 1e6
"""Pixels at which a place behind a camera is shown: nowhere near."""
FREE = 0.1
"""Weight of staying where it is, for each unknown."""

Pair = tuple[int, int]


@dataclass(frozen=True)
class Verdict:
    """camera: where it would show most places where they are; gain: how many times as many; moved: pixels that takes, median.

    features: how many tell.
    """

    camera: Camera
    gain: float = 1.0
    moved: float = 0.0
    features: int = 0

    @property
    def wrong(self) -> bool:
        return self.gain > GAIN and self.moved > MOVED * max(1.0, PLENTY / max(self.features, 1))


class _Sight:
    """What cameras show at some moments, and what they have in common. frames: [T, C, H, W, 3] uint8."""

    def __init__(self, cameras: list[Camera], frames: np.ndarray) -> None:
        self.cameras, self.pairs = list(cameras), neighbor_pairs(cameras, NEIGHBORS)
        self.apart, self.chance = separation(cameras), MATCH_PIXELS / (SEARCH_WIDTHS[0] * cameras[0].width)
        forwards = np.stack([camera.forward for camera in cameras])
        self.narrow = forwards @ forwards.T > np.cos(np.radians(WIDE))
        with ThreadPoolExecutor(threads.count()) as pool:
            self.features = [list(pool.map(detect, images)) for images in frames]
        self.matches = {pair: self._match(pair, SEARCH_WIDTHS[0]) for pair in self.pairs}
        self._near: dict[Pair, np.ndarray] = {}

    def move(self, number: int) -> None:
        """Put a camera where most of what it shows says, ever more closely."""
        around = [pair for pair in self.pairs if number in pair]
        for reach in SEARCH_WIDTHS:
            self.matches |= {pair: self._match(pair, reach) for pair in around}
            self.cameras[number] = self.judge(number).camera
        self.matches |= {pair: self._match(pair, SEARCH_WIDTHS[0]) for pair in around}
        self._near = {pair: near for pair, near in self._near.items() if pair not in around}

    def _match(self, pair: Pair, reach: float) -> list[np.ndarray]:
        """[M, 2] indices of features of two cameras, at each moment."""
        (a, b), cameras = pair, self.cameras
        return [match(cameras[a], cameras[b], seen[a], seen[b], reach * cameras[a].width) for seen in self.features]

    def stranger(self, number: int) -> bool:
        """Whether its features are on the others' lines hardly more often than anything would be that is looked for in reach."""
        near = self._on_lines(self._comparable(number))
        return len(near) >= FEWEST_POINTS_AND_MATCHES[1] and near.mean() < CHANCE * self.chance

    def alone(self, number: int) -> bool:
        """Whether it shows too little of what the others do, whether that fits or not."""
        near = self._on_lines([pair for pair in self.pairs if number in pair])
        return len(self._on_lines(self._comparable(number))) < FEWEST_POINTS_AND_MATCHES[1] and not self._alike(near)

    def _comparable(self, number: int) -> list[Pair]:
        """Its pairs that would show the same things if all were right: others do that are as different and more."""
        others = [pair for pair in self.pairs if number not in pair and self._alike(self._on_lines([pair]))]
        most = max((self.apart[pair] for pair in others), default=0.0)
        return [pair for pair in self.pairs if number in pair and self.narrow[pair] and self.apart[pair] <= most]

    def _alike(self, near: np.ndarray) -> bool:
        return len(near) >= ALIKE[1] and near.mean() > ALIKE[0] * self.chance

    def _on_lines(self, pairs: list[Pair]) -> np.ndarray:
        """[M] bool: which matches of pairs of cameras are on their epipolar lines."""
        for a, b in pairs:
            if (a, b) in self._near:
                continue
            off = [np.zeros(0)]
            for seen, found in zip(self.features, self.matches[a, b], strict=True):
                lines = epipolar_lines(self.cameras[a], self.cameras[b], seen[a].pixels[found[:, 0]])
                off.append(line_distances(lines, seen[b].pixels[found[:, 1]]))
            self._near[a, b] = np.abs(np.concatenate(off)) < MATCH_PIXELS
        return np.concatenate([np.zeros(0, bool), *(self._near[pair] for pair in pairs)])

    def judge(self, number: int) -> Verdict:
        """Where a camera would have to be to show most places where they are that two others agree on."""
        camera = self.cameras[number]
        places, pixels = self._places(number)
        if len(places) < FEWEST_POINTS_AND_MATCHES[0]:
            return Verdict(camera)
        far = [np.linalg.norm(camera.center - other.center) for other in self.cameras if other is not camera]
        units = POSE_STEP * np.repeat([1, float(np.median(far))], 3)

        def off(change: np.ndarray) -> np.ndarray:
            shown, _ = project(_moved(camera, units * change), places)
            return (np.nan_to_num(shown, nan=BEHIND) - pixels).ravel()

        before = off(np.zeros(6))
        slopes = np.stack([(off(unit) - off(-unit)) / 2 for unit in np.eye(6)], 1)
        change = _agreed(before, slopes)
        step = (slopes @ change).reshape(-1, 2)
        before = before.reshape(-1, 2)
        at_once, believed = (np.linalg.norm(error, axis=1) < MATCH_PIXELS for error in (before, before + step))
        moved = float(np.median(np.linalg.norm(step[believed], axis=1))) if believed.any() else 0.0
        gain, features = believed.sum() / max(at_once.sum(), 1), len(np.unique(pixels, axis=0))
        return Verdict(_moved(camera, units * change), gain, moved, features)

    def _places(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Places [M, 3] that two other cameras agree on, and pixels [M, 2] of the features that this one matched with both."""
        projections = np.stack([c.K.astype(np.float64) @ c.viewmat[:3].astype(np.float64) for c in self.cameras])
        centers = np.stack([camera.center for camera in self.cameras]).astype(np.float64)
        places, pixels = [np.zeros((0, 3))], [np.zeros((0, 2))]
        for moment, seen in enumerate(self.features):
            own, others, there = self._shared(number, moment)
            couples = _couples(own)
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
        """Features [E] of a camera, sorted, that others [E] show at pixels [E, 2]."""
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


def check_poses(cameras: list[Camera], frames: np.ndarray) -> Findings:
    """Cameras whose poses are beyond doubt wrong, as they should be, and strangers.

    frames: [T, C, H, W, 3] uint8, some moments: what moves must not be taken for a camera that does. The worst comes first; then
    the others are judged anew.
    """
    sight, mended = _Sight(cameras, frames), set[int]()
    if meant := misread(cameras, sight.features[0], {pair: found[0] for pair, found in sight.matches.items()}):
        return Findings({}, [], [], [], meant)
    everybody = range(len(cameras))
    strangers: list[int] = []
    unchecked: list[int] = []
    for _ in everybody:
        verdicts = {c: sight.judge(c) for c in everybody}
        alone = [c for c in everybody if sight.alone(c)]
        wrong = [c for c in everybody if verdicts[c].wrong and c not in alone]
        strangers = [c for c in everybody if c not in wrong and sight.stranger(c)]
        judged = [c for c in everybody if verdicts[c].features]
        unchecked = [c for c in alone if c not in mended]
        suspects = sorted({*mended, *wrong, *strangers})
        many = bool(suspects) and 3 * len(suspects) >= len(cameras)
        if many and 2 * len(judged) >= len(cameras):
            return Findings({}, [], suspects)
        if many or 2 * len(unchecked) > len(cameras):
            lost = sorted({*suspects, *unchecked})
            misfit = related(sight.features[0], neighbor_pairs(cameras, 1))
            return Findings({}, [], lost) if misfit else Findings({}, [], [], lost)
        if not wrong:
            break
        worst = max(wrong, key=lambda c: verdicts[c].gain)
        sight.move(worst)
        mended.add(worst)
    focus = focus_point(cameras)
    pixels = {c: _apart(cameras[c], sight.cameras[c], focus) for c in mended if c not in strangers}
    return Findings({c: Mended(sight.cameras[c], off) for c, off in pixels.items()}, strangers, [], unchecked)


def _couples(own: np.ndarray) -> np.ndarray:
    """[P, 2] indices of all two entries that are the same in sorted own [E]."""
    couples, gap = [np.zeros((0, 2), int)], 1
    while len(same := np.flatnonzero(own[:-gap] == own[gap:])):
        couples.append(np.stack([same, same + gap], 1))
        gap += 1
    return np.concatenate(couples)


def _agreed(off: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The change [6] that brings most of off [2 M] + slopes [2 M, 6] change near zero: Geman and McClure's weights, ever stricter."""
    change = np.zeros(6)
    for close in np.geomspace(max(np.percentile(np.abs(off), 75), MATCH_PIXELS), MATCH_PIXELS, ROUNDS):
        squares = np.square((off + slopes @ change).reshape(-1, 2)).sum(1).repeat(2)
        weighed = slopes * np.square(close**2 / (squares + close**2))[:, None]
        change = np.linalg.solve(weighed.T @ slopes + FREE * np.eye(6), -weighed.T @ off)
    return change


def _moved(camera: Camera, change: np.ndarray) -> Camera:
    """A camera turned by a rotation vector and moved, [6], both in its own directions."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = cv2.Rodrigues(change[:3])[0], change[3:]
    return replace(camera, viewmat=(motion @ camera.viewmat.astype(np.float64)).astype(np.float32))


def _apart(camera: Camera, moved: Camera, focus: np.ndarray) -> float:
    """Median pixels between where two cameras show what is as far away from the first as focus [3], all over its picture."""
    depth = abs(float(camera.forward @ (focus - camera.center)))
    places = unproject(camera.resized(5, 5), np.full((5, 5), depth))
    return float(np.median(np.linalg.norm(project(moved, places)[0] - project(camera, places)[0], axis=-1)))
