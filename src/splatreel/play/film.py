"""Export of a reel as an ordinary video, rendered on the CPU along a path of cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import overload

import av
import numpy as np

from splatreel.base.atomic import replacing
from splatreel.base.errors import UsageError
from splatreel.play.camera_path import CameraPath, Keyframe, nearest_first
from splatreel.play.reel_sound import FilmSound
from splatreel.play.timeline import Timeline
from splatreel.scene.camera import Camera

Shot = tuple[float, Camera]
"""A frame of a film: seconds of the reel, and the camera that takes it."""
MAX_SHOTS = 1_000_000
"""Maximum number of frames of a film along a path: nine hours at 30 fps."""


class Shots(Sequence[Shot]):
    """The frames of a film, each computed on access."""

    def __init__(self, count: int, make: Callable[[int], Shot]) -> None:
        """Describe `count` frames. make: returns the frame of an index."""
        self._count = count
        self._make = make

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> Shot: ...
    @overload
    def __getitem__(self, index: slice) -> list[Shot]: ...
    def __getitem__(self, index: int | slice) -> Shot | list[Shot]:
        numbers = range(self._count)[index]
        return self._make(numbers) if isinstance(numbers, int) else [self._make(i) for i in numbers]


def film_along_path(path: CameraPath, lens: Camera, fps: float) -> Sequence[Shot]:
    """Return the frames of a film along a camera path, at least one.

    A looping path gives a looping film: its last frame is the one before the first.

    Args:
        path: Camera path.
        lens: Camera with the intrinsics and size of all frames.
        fps: Frames per second.

    Raises:
        UsageError: The path takes too long.
    """
    count = max(round(path.seconds * fps) + (0 if path.loop else 1), 1)
    if count > MAX_SHOTS:
        raise UsageError(
            f"The camera path takes {path.seconds:,.0f} seconds, {count:,} frames; a film has at most {MAX_SHOTS:,}. Give its "
            f"keyframes earlier times."
        )

    def shot(i: int) -> Shot:
        viewmat, time = path.at(i / fps)
        return time, replace(lens, viewmat=viewmat)

    return Shots(count, shot)


def film_through_cameras(
    start: Camera, cameras: Sequence[Camera], frames: int, fps: float, first: int = 0
) -> Sequence[Shot]:
    """Return the frames of a film that plays a reel while the view moves from `start` through the cameras, nearest first.

    Args:
        start: First camera, whose intrinsics and size all frames have.
        cameras: Cameras to pass. One at the position of `start` is skipped. Without others the view does not move.
        frames: Number of frames.
        fps: Frames per second of the reel.
        first: First frame of the reel.
    """
    stops = nearest_first(start, cameras)
    leg = (frames - 1) / fps / max(len(stops) - 1, 1)
    if leg <= 0:
        stops = stops[:1]
    keyframes = [
        Keyframe(i * leg, first / fps + i * leg, stop.viewmat.astype(np.float64)) for i, stop in enumerate(stops)
    ]
    path = CameraPath(keyframes)
    return Shots(frames, lambda i: ((first + i) / fps, replace(start, viewmat=path.at(i / fps)[0])))


def sound_start(shots: Sequence[Shot], fps: float) -> float | None:
    """Return the time of the reel at which a film starts, in seconds; None if the film does not play at the reel's speed."""
    start = shots[0][0]
    return start if all(abs(seconds - start - i / fps) < 0.5 / fps for i, (seconds, _) in enumerate(shots)) else None


def write_film(
    path: Path, reel: Timeline, shots: Sequence[Shot], report: Callable[[int], None] = lambda done: None
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
