"""People in images, by MediaPipe's networks: where they are, and how probably each pixel shows one.

The package `mediapipe` ships the networks, and LiteRT runs them on the CPU. Nothing is downloaded, and `mediapipe` is not imported.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.base.command_line import install_command
from splatreel.base.errors import MissingDependencyError
from splatreel.base.untrusted import read_file

INSTALL = "pip install --no-deps mediapipe==0.10.21"
"""Command that installs the networks. With its dependencies, pip would install JAX and others, which nothing here uses."""
NEWEST = (3, 12)
"""Newest Python that this version has wheels for."""
LARGEST = 32 << 20
"""Largest size of a file of a network, bytes."""
FILES = {
    "pose_detection": "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    "pose_landmark_full": "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
    "selfie_segmentation": "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
}
"""SHA-256 of the file of each network."""
INPUT, DETECTION_INPUT = 256, 224
"""Width of the square images that the networks take, pixels."""
STRIDES = ((8, 2), (16, 2), (32, 6))
"""Pixels between anchors of the detection, and anchors at each place."""
DETECTED, OVERLAP = 0.5, 0.5
"""Smallest probability of a detected person, and the largest overlap of two people's squares, as a share of the smaller one."""
LEAST_AREA, LEAST_SIDE = 0.004, 20
"""Smallest part of a mask that may be a person: area as a share of the image, and pixels along its larger side."""
PRESENT = 0.5
"""Smallest probability of the network of landmarks that its square holds a person."""
ENLARGED = 1.25
"""Width of a person's square, relative to the diameter of the circle around the middle of the hips that holds the whole body."""
POSSIBLE = 0.2
"""Probability of a person above which a pixel teaches nothing about the background."""
CORNERS = np.array([[[0, 0], [1, 0], [1, 1], [0, 1]]], np.float64)
"""Corners of the unit square."""
LANDMARKS, HIPS, REACH = 33, 33, 34
"""Number of landmarks, and the outputs after them: the middle of the hips, and a point on the circle around it that holds the body."""
PASSES = (("pose", 2.0), ("pose", 2.5), ("selfie", 1.0), ("selfie", 1.25))
"""Networks that are averaged, and the width of their squares relative to a person's larger side. Each also sees the mirror image."""


@dataclass(frozen=True)
class Square:
    """A square around a person, in pixels of the image.

    Attributes:
        x, y: Center.
        side: Larger side of the person.
        angle: Angle of the person's up direction, radians clockwise from the image's.
    """

    x: float
    y: float
    side: float
    angle: float = 0.0

    def transform(self, width: int, scale: float = 1.0) -> np.ndarray:
        """Return the affine matrix [2, 3] from the image to an upright square image `width` wide, of `scale` times the side."""
        zoom = width / (scale * self.side)
        c, s = np.cos(self.angle) * zoom, np.sin(self.angle) * zoom
        return np.array(
            [[c, s, width / 2 - c * self.x - s * self.y], [-s, c, width / 2 + s * self.x - c * self.y]], np.float64
        )


@dataclass(frozen=True)
class Landmarks:
    """Landmarks of a person in an image.

    Attributes:
        points: [33, 2] pixels, in MediaPipe's order.
        visible: [33] probability that the image shows them.
        side: Side of the square that holds the body, pixels.
    """

    points: np.ndarray
    visible: np.ndarray
    side: float


Network = Callable[[np.ndarray], dict[tuple[int, ...], np.ndarray]]
"""Takes an image [S, S, 3] float32 in 0..1 and returns outputs by their shapes without the leading 1."""


class People:
    """Finds people in images by three networks.

    Args:
        networks: Networks by the names of `FILES`.
    """

    def __init__(self, networks: dict[str, Network]) -> None:
        self._networks = networks

    def find(self, image: np.ndarray, angle: float = 0.0) -> list[Square]:
        """Return a square around each person in an image [H, W, 3] uint8.

        The network sees the whole image and squares of the image's smaller side, so that people are not too small for it.

        Args:
            image: [H, W, 3] uint8.
            angle: Angle of the scene's up direction in the image, radians clockwise.
        """
        found: list[tuple[float, Square]] = []
        for window in _windows(image, angle):
            found += self._detect(image, window)
        kept: list[Square] = []
        for _, square in sorted(found, key=lambda pair: -pair[0]):
            if all(_overlap(square, other) < OVERLAP for other in kept) and self._is_person(image, square):
                kept.append(square)
        return kept

    def _is_person(self, image: np.ndarray, square: Square) -> bool:
        """Return whether the network of landmarks, which sees a person closer, agrees with the detection."""
        crop = _crop(image, square.transform(INPUT, ENLARGED), INPUT)
        return bool(self._networks["pose_landmark_full"](crop)[(1,)][0] > PRESENT)

    def _detect(self, image: np.ndarray, window: Square) -> list[tuple[float, Square]]:
        transform = window.transform(DETECTION_INPUT)
        outputs = self._networks["pose_detection"](2 * _crop(image, transform, DETECTION_INPUT) - 1)
        anchors = _anchors()
        odds = outputs[len(anchors), 1][:, 0]
        likely = np.flatnonzero(odds > np.log(DETECTED / (1 - DETECTED)))
        points = outputs[len(anchors), 12][likely, 4:8].reshape(-1, 2, 2) + anchors[likely, None] * DETECTION_INPUT
        back = cv2.invertAffineTransform(transform)
        pairs = points @ back[:, :2].T + back[:, 2]
        return [(float(odds[k]), _square_of(hips, reach)) for k, (hips, reach) in zip(likely, pairs, strict=True)]

    def landmarks(self, image: np.ndarray, square: Square) -> Landmarks | None:
        """Return the landmarks of the person in a square of an image [H, W, 3] uint8; None if nobody is there."""
        first = self._look(image, square)
        if first is None:
            return None
        second = self._look(image, first[1])  # in the square that follows from the first landmarks
        return None if second is None else second[0]

    def _look(self, image: np.ndarray, square: Square) -> tuple[Landmarks, Square] | None:
        transform = square.transform(INPUT, ENLARGED)
        outputs = self._networks["pose_landmark_full"](_crop(image, transform, INPUT))
        if outputs[(1,)][0] < PRESENT:
            return None
        found = outputs[(195,)].reshape(-1, 5)
        back = cv2.invertAffineTransform(transform)
        points = found[:, :2] @ back[:, :2].T + back[:, 2]
        around = _square_of(*points[[HIPS, REACH]])
        visible = 1 / (1 + np.exp(-np.clip(found[:LANDMARKS, 3], -20, 20)))
        return Landmarks(points[:LANDMARKS] + 0.5, visible, around.side), around  # OpenCV's pixels begin at -0.5

    def probability(self, image: np.ndarray, squares: Sequence[Square]) -> tuple[np.ndarray, np.ndarray]:
        """Return how probably each pixel shows a person, [H, W] float32 in 0..1, and where that is known, [H, W] bool.

        It is the mean of networks, crops and mirror images. It is unknown outside of the crops, and in squares without a person.

        Args:
            image: [H, W, 3] uint8.
            squares: Squares around what may be a person.
        """
        size = image.shape[1::-1]
        total, known = np.zeros(image.shape[:2], np.float32), np.zeros(image.shape[:2], bool)
        for square in squares:
            found, reach = np.zeros_like(total), 0.0
            for network, scale in PASSES:
                transform = square.transform(INPUT, scale)
                crop = _crop(image, transform, INPUT)
                seen = (self._segment(network, crop) + self._segment(network, crop[:, ::-1])[:, ::-1]) / 2
                flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
                found += cv2.warpAffine(seen.astype(np.float32), transform, size, flags=flags) / len(PASSES)
                reach = max(reach, scale)
            if found.max() > PRESENT:
                corners = cv2.transform(CORNERS, cv2.invertAffineTransform(square.transform(1, reach)))
                known |= cv2.fillConvexPoly(np.zeros_like(total), corners.round().astype(np.int32), 1.0) > 0
                np.maximum(total, found, out=total)
        return total, known

    def _segment(self, network: str, crop: np.ndarray) -> np.ndarray:
        if network == "selfie":
            return self._networks["selfie_segmentation"](crop)[INPUT, INPUT, 1][..., 0]
        odds = self._networks["pose_landmark_full"](crop)[INPUT, INPUT, 1][..., 0]
        return 1 / (1 + np.exp(-np.clip(odds, -20, 20)))


def _square_of(hips: np.ndarray, reach: np.ndarray) -> Square:
    """Return the square around a person by the middle of the hips and a point above it on the circle that holds the body, [2] each."""
    up = reach - hips
    return Square(float(hips[0]), float(hips[1]), 2 * float(np.linalg.norm(up)), float(np.arctan2(up[0], -up[1])))


def _crop(image: np.ndarray, transform: np.ndarray, width: int) -> np.ndarray:
    """Return a part of an image as [width, width, 3] float32 in 0..1. Its border continues outside."""
    shrinks = abs(np.linalg.det(transform[:, :2])) < 1
    flags = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    crop = cv2.warpAffine(image, transform, (width, width), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return crop.astype(np.float32) / 255


def _windows(image: np.ndarray, angle: float) -> Iterator[Square]:
    """Yield the squares in which people are looked for: one around the image, and three or more of its smaller side."""
    height, width = image.shape[:2]
    small, large = sorted((height, width))
    yield Square(width / 2, height / 2, float(large), angle)
    if large < 1.2 * small:
        return
    for at in np.linspace(small / 2, large - small / 2, max(2, round(2 * large / small) - 1)):
        yield Square(*((at, height / 2) if width > height else (width / 2, at)), float(small), angle)


def _overlap(a: Square, b: Square) -> float:
    """Return the share of the smaller square that the larger one covers, both upright."""
    inside = [
        min(p + a.side / 2, q + b.side / 2) - max(p - a.side / 2, q - b.side / 2) for p, q in ((a.x, b.x), (a.y, b.y))
    ]
    return max(inside[0], 0) * max(inside[1], 0) / min(a.side, b.side) ** 2


@cache
def _anchors() -> np.ndarray:
    """Return the places, 0..1, that the detection's outputs are relative to, [N, 2].

    Source:
        MediaPipe, pose_detection_cpu.pbtxt: SsdAnchorsCalculator.
    """
    out = []
    for stride, count in STRIDES:
        places = (np.arange(DETECTION_INPUT // stride, dtype=np.float32) + 0.5) * stride / DETECTION_INPUT
        y, x = np.meshgrid(places, places, indexing="ij")
        out.append(np.repeat(np.stack([x.ravel(), y.ravel()], 1), count, 0))
    return np.concatenate(out)


def squares_around(mask: np.ndarray) -> list[Square]:
    """Return an upright square around each large part of a mask [H, W] bool."""
    wide = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8))
    _, _, boxes, _ = cv2.connectedComponentsWithStats(wide)
    large = [box for box in boxes[1:].tolist() if box[4] > LEAST_AREA * mask.size and max(box[2:4]) > LEAST_SIDE]
    return [Square(x + width / 2, y + height / 2, float(max(width, height))) for x, y, width, height, _ in large]


def without_repeats(squares: Sequence[Square], more: Sequence[Square]) -> list[Square]:
    """Return squares and those of `more` that do not lie within them."""
    return [*squares, *(square for square in more if all(_overlap(square, other) < OVERLAP for other in squares))]


def people_free(people: People, film: np.ndarray, angle: float = 0.0) -> np.ndarray:
    """Return the pixels [S, H, W] bool of samples [S, H, W, 3] uint8 that show no person, nor lie close to one."""

    def covered(image: np.ndarray) -> np.ndarray:
        probability = people.probability(image, people.find(image, angle))[0]
        return cv2.dilate((probability > POSSIBLE).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0

    return ~np.stack(threads.map_parallel(covered, film))


def find_people() -> People | None:
    """Return the networks; None where LiteRT or the package that holds them is not installed.

    Raises:
        MissingDependencyError: A file is damaged or of another version.
    """
    spec = importlib.util.find_spec("mediapipe")
    if spec is None or spec.origin is None or importlib.util.find_spec("ai_edge_litert") is None:
        return None
    folder = Path(spec.origin).parent / "modules"
    paths = {name: folder / name.replace("_full", "") / f"{name}.tflite" for name in FILES}
    if not any(path.is_file() for path in paths.values()):
        return None  # versions that ship no networks
    return People({name: _load(path, FILES[name]) for name, path in paths.items()})


def how_to_install() -> str:
    """Return the commands that install what `find_people` needs."""
    newer = " (docs/install.md has the command for this Python)" if sys.version_info[:2] > NEWEST else ""
    return f"{install_command('people')}, then {INSTALL}{newer}"


def _load(path: Path, expected: str) -> Network:
    data = read_file(path, LARGEST, _damaged)
    found = hashlib.sha256(data).hexdigest()
    if found != expected:
        raise _damaged(f"{path}: its SHA-256 is {found[:12]}..., not {expected[:12]}...")
    return network_of(data)


def _damaged(message: str) -> MissingDependencyError:
    return MissingDependencyError(f"{message} Install it again: {INSTALL} --force-reinstall")


def network_of(model: bytes) -> Network:
    """Return the network of a TensorFlow Lite file, run by LiteRT. Threads may share it."""
    from ai_edge_litert.interpreter import Interpreter

    idle: list[Any] = []  # appending and popping are atomic

    def run(image: np.ndarray) -> dict[tuple[int, ...], np.ndarray]:
        try:
            interpreter = idle.pop()
        except IndexError:
            interpreter = Interpreter(model_content=model, num_threads=1)
            interpreter.allocate_tensors()
        interpreter.set_tensor(interpreter.get_input_details()[0]["index"], np.ascontiguousarray(image[None]))
        interpreter.invoke()
        outputs = interpreter.get_output_details()
        found = {tuple(map(int, each["shape"][1:])): interpreter.get_tensor(each["index"])[0] for each in outputs}
        idle.append(interpreter)
        return found

    return run
