"""Cameras that are not where they are said to be, and such as show something else (beyond the paper).

Features that cameras share must lie on each other's epipolar lines. Where those of one camera do so only if it is turned and moved a
little, it was touched after its calibration: all others see the scene twice until it is put right. Where they never do more often
than by chance, it is somewhere else, or its video is another camera's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from splatreel.motion.flow import DisFlow, each_view
from splatreel.recon.features import Features, detect, epipolar_lines, match, off_line
from splatreel.recon.triangulate import neighbour_pairs
from splatreel.scene.camera import Camera, focus_point

NEIGHBOURS = 6
REACHES = 0.03, 0.015, 0.008
"""Of the picture's width: how far off their lines features are looked for, from round to round; nobody is put right by more."""
CLOSE = 0.7
"""Pixels off the line by which a match is believed."""
ROUNDS = 25
MOVED = 0.3
"""Pixels that what a camera shows must be off its lines, in the median, for it to be touched. Along them it may be off by more."""
GAIN = 1.4
"""Times as many matches must be believed then."""
FEWEST = 40, 200
"""Matches by which a camera is judged, and by which it is a stranger."""
CHANCE = 2.0
"""Times as many matches as by chance that are believed of any camera that sees what the others do."""
STEP = 1e-3
"""Radians, and of the cameras' distance from each other: what six unknowns of a pose are counted in."""
FREE = 0.1
"""Weight of staying where it is, for each unknown."""


Pair = tuple[int, int]
Matches = tuple[np.ndarray, np.ndarray]
"""Pixels [M, 2] of the first camera of a pair and of the second."""


@dataclass(frozen=True)
class Mended:
    """A camera that was put right. pixels: by how much what it shows moves, median of places as far as most cameras look."""

    camera: Camera
    pixels: float


@dataclass(frozen=True)
class Findings:
    """What an inspection found, by index of the cameras.

    mended: those that were put right. strangers: those that do not show what their neighbours do. doubtful: all that seem wrong, if
    they are so many that nobody can tell which are right; the others are empty then.
    """

    mended: dict[int, Mended]
    strangers: list[int]
    doubtful: list[int]


@dataclass(frozen=True)
class _Verdict:
    """camera: where it would show most of its matches on their lines; moved: pixels across the lines that takes them there, median.

    believed: matches on their lines as it stands, and there, of how many.
    """

    camera: Camera
    moved: float
    believed: tuple[int, int]
    matches: int

    @property
    def gain(self) -> float:
        """Times as many matches are believed there."""
        return self.believed[1] / max(self.believed[0], 1)

    @property
    def wrong(self) -> bool:
        return self.matches >= FEWEST[0] and self.gain > GAIN and self.moved > MOVED

    @property
    def strange(self) -> bool:
        """On no line more often than anything would be that is looked for in its reach."""
        chance = CLOSE / (REACHES[0] * self.camera.width)
        return self.matches >= FEWEST[1] and self.believed[1] < CHANCE * chance * self.matches


def inspect(cameras: list[Camera], frames: np.ndarray) -> Findings:
    """Cameras whose poses are beyond doubt wrong, as they should be, and strangers.

    frames: [T, C, H, W, 3] uint8, some moments: what moves must not be taken for a camera that does. The worst comes first; then
    the others are judged anew.
    """
    features = [each_view(lambda c, images=images: detect(images[c]), len(cameras), DisFlow()) for images in frames]
    placed, mended = list(cameras), dict[int, Mended]()
    pairs = neighbour_pairs(cameras, NEIGHBOURS)
    matches = {pair: _matched(pair, placed, features, REACHES[0]) for pair in pairs}
    strangers: list[int] = []
    for _ in cameras:
        verdicts = {c: _judged(c, placed, matches) for c in range(len(cameras))}
        strangers = [c for c, verdict in verdicts.items() if verdict.strange]
        wrong = [c for c, verdict in verdicts.items() if verdict.wrong and not verdict.strange]
        suspects = sorted({*mended, *wrong, *strangers})
        if suspects and 3 * len(suspects) >= len(cameras):
            return Findings({}, [], suspects)
        if not wrong:
            break
        worst = max(wrong, key=lambda c: verdicts[c].gain)
        around = [pair for pair in pairs if worst in pair]
        for reach in REACHES:
            near = {pair: _matched(pair, placed, features, reach) for pair in around}
            placed[worst] = _judged(worst, placed, near).camera
        matches |= {pair: _matched(pair, placed, features, REACHES[0]) for pair in around}
        mended[worst] = Mended(placed[worst], _apart(cameras[worst], placed[worst], focus_point(cameras)))
    return Findings({c: m for c, m in mended.items() if c not in strangers}, strangers, [])


def _matched(pair: Pair, cameras: list[Camera], features: list[list[Features]], reach: float) -> Matches:
    """What two cameras share at all moments."""
    a, b = pair
    found = [match(cameras[a], cameras[b], seen[a], seen[b], reach * cameras[a].width) for seen in features]
    here, there = (
        np.concatenate([seen[camera].pixels[which[:, side]] for seen, which in zip(features, found, strict=True)])
        for side, camera in enumerate(pair)
    )
    return here, there


def _judged(number: int, cameras: list[Camera], matches: dict[Pair, Matches]) -> _Verdict:
    """Where a camera would have to be for most of its matches to lie on their lines."""
    camera, sides = cameras[number], [(pair, pair.index(number)) for pair in matches if number in pair]
    others = [cameras[pair[1 - side]] for pair, side in sides]
    here, there = ([matches[pair][abs(side - k)] for pair, side in sides] for k in (0, 1))
    count = sum(len(pixels) for pixels in here)
    if count == 0:
        return _Verdict(camera, 0.0, (0, 0), 0)
    length = float(np.median([np.linalg.norm(camera.center - other.center) for other in others]))

    def moved(change: np.ndarray) -> Camera:
        return _moved(camera, STEP * change * np.repeat([1, length], 3))

    def off(change: np.ndarray) -> np.ndarray:
        turned = moved(change)
        lines = [epipolar_lines(other, turned, pixels) for other, pixels in zip(others, there, strict=True)]
        return off_line(np.concatenate(lines), np.concatenate(here))

    before = off(np.zeros(6))
    slopes = np.stack([(off(unit) - off(-unit)) / 2 for unit in np.eye(6)], 1)
    change = _agreed(before, slopes)
    after = before + slopes @ change
    believed, at_once = np.abs(after) < CLOSE, np.abs(before) < CLOSE
    across = float(np.median(np.abs(after - before)[believed])) if believed.any() else 0.0
    return _Verdict(moved(change), across, (int(at_once.sum()), int(believed.sum())), count)


def _agreed(off: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The change [6] that brings most of off [M] + slopes [M, 6] change near zero: Geman and McClure's weights, ever stricter."""
    change = np.zeros(6)
    for close in np.geomspace(max(np.percentile(np.abs(off), 75), CLOSE), CLOSE, ROUNDS):
        squares = np.square(off + slopes @ change)
        weighed = slopes * np.square(close**2 / (squares + close**2))[:, None]
        change = np.linalg.solve(weighed.T @ slopes + FREE * np.eye(6), -weighed.T @ off)
    return change


def _moved(camera: Camera, change: np.ndarray) -> Camera:
    """A camera turned by a rotation vector and moved, [6], both in its own directions."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = cv2.Rodrigues(change[:3])[0], change[3:]
    return replace(camera, viewmat=(motion @ camera.viewmat.astype(np.float64)).astype(np.float32))


def _apart(camera: Camera, moved: Camera, focus: np.ndarray) -> float:
    """Median pixels between what a camera shows as far away as focus [3] and where it shows that when moved."""
    across = np.stack(np.meshgrid(np.linspace(0, camera.width, 5), np.linspace(0, camera.height, 5)), -1).reshape(-1, 2)
    K, inverse = camera.K.astype(np.float64), np.linalg.inv(camera.viewmat.astype(np.float64))
    depth = abs(float(camera.forward @ (focus - camera.center)))
    places = depth * np.c_[across, np.ones(len(across))] @ np.linalg.inv(K).T @ inverse[:3, :3].T + inverse[:3, 3]
    pixels = (places @ moved.viewmat[:3, :3].T + moved.viewmat[:3, 3]) @ K.T
    return float(np.median(np.linalg.norm(pixels[:, :2] / pixels[:, 2:] - across, axis=1)))
