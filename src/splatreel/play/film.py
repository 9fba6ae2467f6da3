"""Export of a reel as an ordinary video, rendered on the CPU along a path of cameras."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeGuard, overload

import av
import numpy as np
from scipy.spatial.transform import Rotation

from splatreel.base.atomic import replacing
from splatreel.base.errors import UsageError
from splatreel.base.untrusted import read_json
from splatreel.play.reel_sound import FilmSound
from splatreel.play.timeline import Timeline
from splatreel.scene.camera import Camera

FORMAT = "splatreel-path"
VERSION = 1
_MAX_KEYFRAMES = 10_000
MAX_BYTES = 16 << 20
_SAME = 1e-5
"""A loop whose ends differ by less than this, in radians and relative to its length, is smooth at its ends."""


@dataclass(frozen=True)
class Keyframe:
    """A view and a time of the reel at a time of the path."""

    at: float
    """Seconds from the start of the path."""
    time: float
    """Seconds of the reel."""
    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV."""


class CameraPath:
    """A smooth path through keyframes.

    Positions follow cubic Hermite curves. The tangent at a keyframe is that of the parabola through it and its neighbors. Rotations
    follow the same curves on the sphere. The time of the reel is linear between keyframes.
    """

    def __init__(self, keyframes: Sequence[Keyframe], loop: bool = False) -> None:
        """Prepare the tangents.

        Args:
            keyframes: At least one, with increasing `at`.
            loop: Whether the path repeats. It is smooth at its ends if the first and last view agree.
        """
        self.keyframes = tuple(keyframes)
        self.loop = loop
        poses = np.stack([k.viewmat for k in keyframes]).astype(np.float64)
        self._eyes = -(poses[:, :3, :3].swapaxes(1, 2) @ poses[:, :3, 3:])[..., 0]
        self._turns = [Rotation.from_matrix(pose[:3, :3].T) for pose in poses]
        self._steps = np.diff([k.at for k in keyframes])
        ways = np.diff(self._eyes, axis=0)
        arcs = np.reshape([_between(*pair) for pair in pairwise(self._turns)], (-1, 3))
        gap = np.linalg.norm(self._eyes[-1] - self._eyes[0])
        near = gap <= _SAME * np.linalg.norm(ways, axis=1).sum()
        turned = np.linalg.norm(_between(self._turns[-1], self._turns[0]))
        closed = bool(loop and len(ways) > 1 and near and turned <= _SAME)
        self._speeds = _tangents(ways, self._steps, closed)
        self._spins = _tangents(arcs, self._steps, closed)

    @property
    def seconds(self) -> float:
        """Duration of the path."""
        return self.keyframes[-1].at

    def at(self, seconds: float) -> tuple[np.ndarray, float]:
        """Return the viewmat, [4, 4] float64, and the time of the reel at a time of the path, all in seconds."""
        now = seconds % self.seconds if self.loop and self.seconds > 0 else seconds
        times = [k.at for k in self.keyframes]
        i = int(np.clip(np.searchsorted(times, now, "right") - 1, 0, max(len(times) - 2, 0)))
        before = self.keyframes[i]
        if len(times) == 1:
            return before.viewmat, before.time
        after, step = self.keyframes[i + 1], self._steps[i]
        t = float(np.clip((now - before.at) / step, 0, 1))
        speeds, spins = self._speeds[i : i + 2] * step, self._spins[i : i + 2] * step
        eye = _hermite(self._eyes[i], speeds[0], self._eyes[i + 1], speeds[1], t)
        turn = _arc(self._turns[i], spins[0], self._turns[i + 1], spins[1], t).as_matrix().T
        viewmat = np.eye(4)
        viewmat[:3, :3], viewmat[:3, 3] = turn, -turn @ eye
        return viewmat, before.time + (after.time - before.time) * t


def _nearest_first(start: Camera, cameras: Sequence[Camera]) -> list[Camera]:
    """Order cameras from `start` on, each followed by the nearest one left. A camera at the position of `start` is left out."""
    stops = [start]
    left = [c for c in cameras if np.linalg.norm(c.center - start.center) > 1e-6]
    while left:
        distances = [np.linalg.norm(c.center - stops[-1].center) for c in left]
        stops.append(left.pop(int(np.argmin(distances))))
    return stops


def read_path(file: Path) -> CameraPath:
    """Read a camera path that the player saved. Raises `UsageError` with the invalid value and its remedy."""
    document = read_json(file, lambda text: UsageError(f"{text} Give a camera path that the player saved."), MAX_BYTES)
    try:
        return _parse(document)
    except ValueError as error:
        raise UsageError(f"{file} is not a camera path: {error}") from error


def _parse(document: Any) -> CameraPath:
    """Check the fields. Raises ValueError with the invalid value and its remedy."""
    fields = document if isinstance(document, dict) else {}
    if fields.get("format") != FORMAT:
        raise ValueError(f"its format is {_short(fields.get('format'))}. Give one that the player saved.")
    if fields.get("version") != VERSION or isinstance(fields["version"], bool):
        raise ValueError(f"its version is {_short(fields.get('version'))}, this is for {VERSION}. Update Splatreel.")
    entries = fields.get("keyframes")
    if not isinstance(entries, list) or not 1 <= len(entries) <= _MAX_KEYFRAMES:
        raise ValueError(f"its keyframes are not a list of 1 to {_MAX_KEYFRAMES}. Add one.")
    keyframes: list[Keyframe] = []
    for i, entry in enumerate(entries):
        keyframes.append(
            _parse_keyframe(entry if isinstance(entry, dict) else {}, i, keyframes[-1].at if keyframes else -1)
        )
    return CameraPath(keyframes, fields.get("loop") is True)


def _parse_keyframe(entry: dict[str, Any], index: int, before: float) -> Keyframe:
    def wrong(name: str, remedy: str) -> ValueError:
        return ValueError(f"{name} of keyframe {index} is {_short(entry.get(name))}. {remedy}")

    at, time, values = entry.get("at"), entry.get("time"), entry.get("viewmat")
    if not _is_number(at, 0, 1e6) or at <= before:
        raise wrong("at", "Give seconds from 0 on that grow from keyframe to keyframe.")
    if not _is_number(time, 0, 1e6):
        raise wrong("time", "Give seconds of the reel, from 0 on.")
    remedy = "Give 16 numbers, row by row: a turn, a shift, and 0, 0, 0, 1."
    if not isinstance(values, list) or len(values) != 16 or not all(_is_number(v, -1e12, 1e12) for v in values):
        raise wrong("viewmat", remedy)
    viewmat = np.array(values, np.float64).reshape(4, 4)
    turn = viewmat[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() >= 1e-3 or np.linalg.det(turn) < 0 or values[12:] != [0, 0, 0, 1]:
        raise wrong("viewmat", remedy)
    return Keyframe(float(at), float(time), viewmat)


def _is_number(value: object, low: float, high: float) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


def _short(value: object) -> str:
    return "absent" if value is None else json.dumps(value)[:80]


def _tangents(moves: np.ndarray, steps: np.ndarray, closed: bool) -> np.ndarray:
    """Return the rates of change [N, 3] at the keyframes of a curve.

    The rate is that of the parabola through three keyframes, limited to three times the slower side, so that the curve does not move
    between equal keyframes.

    Args:
        moves: [N - 1, 3] differences between keyframes.
        steps: [N - 1] seconds between keyframes.
        closed: Whether the last keyframe equals the first.
    """
    if not len(moves):
        return np.zeros((1, 3))
    rates = moves / steps[:, None]
    result = np.concatenate([rates[:1], rates])
    pairs = [(i - 1, i) for i in range(1, len(moves))]
    for a, b in [*pairs, (len(moves) - 1, 0)] if closed else pairs:
        mean = (rates[a] * steps[b] + rates[b] * steps[a]) / (steps[a] + steps[b])
        most = 3 * min(np.linalg.norm(rates[a]), np.linalg.norm(rates[b]))
        result[a + 1] = mean * min(most / max(np.linalg.norm(mean), 1e-12), 1)
    if closed:
        result[0] = result[-1]
    return result


def _hermite(a: np.ndarray, u: np.ndarray, b: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """Interpolate from a to b at t in 0..1, with tangents u and v."""
    return (1 - 3 * t**2 + 2 * t**3) * a + (3 * t**2 - 2 * t**3) * b + (t - 2 * t**2 + t**3) * u + (t**3 - t**2) * v


def _arc(a: Rotation, u: np.ndarray, b: Rotation, v: np.ndarray, t: float) -> Rotation:
    """Interpolate rotations likewise, by de Casteljau's algorithm. u and v: rotation vectors in the camera's frame."""
    points = [a, a * Rotation.from_rotvec(u / 3), b * Rotation.from_rotvec(-v / 3), b]
    while len(points) > 1:
        points = [p * Rotation.from_rotvec(t * _between(p, q)) for p, q in pairwise(points)]
    return points[0]


def _between(a: Rotation, b: Rotation) -> np.ndarray:
    """Return the shortest rotation from a to b as a rotation vector [3] in the frame of a."""
    return (a.inv() * b).as_rotvec()


_Shot = tuple[float, Camera]
"""A frame of a film: seconds of the reel, and the camera that takes it."""
_MAX_SHOTS = 1_000_000
"""Maximum number of frames of a film along a path: nine hours at 30 fps."""


class Shots(Sequence[_Shot]):
    """The frames of a film, each computed on access."""

    def __init__(self, count: int, make: Callable[[int], _Shot]) -> None:
        """Describe `count` frames. make: returns the frame of an index."""
        self._count = count
        self._make = make

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> _Shot: ...
    @overload
    def __getitem__(self, index: slice) -> list[_Shot]: ...
    def __getitem__(self, index: int | slice) -> _Shot | list[_Shot]:
        numbers = range(self._count)[index]
        return self._make(numbers) if isinstance(numbers, int) else [self._make(i) for i in numbers]


def film_along_path(path: CameraPath, lens: Camera, fps: float) -> Sequence[_Shot]:
    """Return the frames of a film along a camera path, at least one.

    A looping path gives a looping film: its last frame is the one before the first.

    `lens`: Camera with the intrinsics and size of all frames.

    Raises:
        UsageError: The path takes too long.
    """
    count = max(round(path.seconds * fps) + (0 if path.loop else 1), 1)
    if count > _MAX_SHOTS:
        raise UsageError(
            f"The camera path takes {path.seconds:,.0f} seconds, {count:,} frames; a film has at most {_MAX_SHOTS:,}. Give its "
            f"keyframes earlier times."
        )

    def shot(i: int) -> _Shot:
        viewmat, time = path.at(i / fps)
        return time, replace(lens, viewmat=viewmat)

    return Shots(count, shot)


def film_through_cameras(
    start: Camera, cameras: Sequence[Camera], frames: int, fps: float, first: int = 0
) -> Sequence[_Shot]:
    """Return the frames of a film that plays a reel while the view moves from `start` through the cameras, nearest first.

    Args:
        start: First camera, whose intrinsics and size all frames have.
        cameras: Cameras to pass. One at the position of `start` is skipped. Without others the view does not move.
        frames: Number of frames.
        fps: Frames per second of the reel.
        first: First frame of the reel.
    """
    stops = _nearest_first(start, cameras)
    leg = (frames - 1) / fps / max(len(stops) - 1, 1)
    if leg <= 0:
        stops = stops[:1]
    keyframes = [
        Keyframe(i * leg, first / fps + i * leg, stop.viewmat.astype(np.float64)) for i, stop in enumerate(stops)
    ]
    path = CameraPath(keyframes)
    return Shots(frames, lambda i: ((first + i) / fps, replace(start, viewmat=path.at(i / fps)[0])))


def sound_start(shots: Sequence[_Shot], fps: float) -> float | None:
    """Return the time of the reel at which a film starts, in seconds; None if the film does not play at the reel's speed."""
    start = shots[0][0]
    return start if all(abs(seconds - start - i / fps) < 0.5 / fps for i, (seconds, _) in enumerate(shots)) else None


def write_film(
    path: Path, reel: Timeline, shots: Sequence[_Shot], report: Callable[[int], None] = lambda done: None
) -> None:
    """Write frames of a reel as H.264 in MP4, atomically, with AAC sound if the film plays at the reel's speed.

    The same frames give the same bytes.

    Args:
        path: File to write.
        reel: Reel to render.
        shots: Frames, whose cameras have the same size. An odd width or height is reduced by one, since players expect even ones.
        report: Called with the number of finished frames.
    """
    width, height = shots[0][1].width // 2 * 2, shots[0][1].height // 2 * 2
    with (
        replacing(path) as temporary,
        av.open(
            str(temporary), "w", format="mp4", options={"movflags": "faststart", "fflags": "+bitexact"}
        ) as container,
    ):
        stream = container.add_stream("libx264", rate=Fraction(reel.fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.codec_context.thread_count = 1
        # With several threads, or with the macroblock tree of x264, the bytes would depend on the machine and its load.
        stream.options = {"crf": "17", "preset": "medium", "flags": "+bitexact", "x264-params": "mbtree=0"}
        start = sound_start(shots, reel.fps)
        sound = FilmSound(container, reel.sound, start) if reel.sound is not None and start is not None else None
        for done, (seconds, camera) in enumerate(shots):
            image = reel.render(reel.at(seconds), camera)
            pixels = np.rint(np.clip(image[:height, :width], 0, 1) * 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), "rgb24")))
            if sound is not None:
                sound.write((done + 1) / reel.fps)
            report(done + 1)
        container.mux(stream.encode())
        if sound is not None:
            sound.finish()
