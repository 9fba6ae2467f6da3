"""A reel as an ordinary video: rendered on the CPU, a frame at a time, along a path of cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import overload

import av
import numpy as np

from splatreel.errors import UsageError
from splatreel.play.camera_path import CameraPath, Keyframe, in_order
from splatreel.play.sound import FilmSound
from splatreel.play.timeline import Timeline
from splatreel.scene.atomic import replacing
from splatreel.scene.camera import Camera

Shot = tuple[float, Camera]
"""A picture of a film: seconds of the reel, and the camera that takes it."""
MOST_SHOTS = 1_000_000
"""Pictures of a film along a path: nine hours at 30 a second."""


class Shots(Sequence[Shot]):
    """The pictures of a film, each made when it is asked for. count: how many there are; make: makes the one of a number."""

    def __init__(self, count: int, make: Callable[[int], Shot]) -> None:
        self._count, self._make = count, make

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> Shot: ...
    @overload
    def __getitem__(self, index: slice) -> list[Shot]: ...
    def __getitem__(self, index: int | slice) -> Shot | list[Shot]:
        numbers = range(self._count)[index]
        return self._make(numbers) if isinstance(numbers, int) else [self._make(i) for i in numbers]


def film_of(path: CameraPath, lens: Camera, fps: float) -> Sequence[Shot]:
    """The pictures of a film along a path, as many as its seconds have at this rate, and at least one; all through this lens.

    Of a path that loops the last picture is the one before the first, so that the film loops as well. Raises `UsageError` for a path
    that takes too long.
    """
    count = max(round(path.seconds * fps) + (0 if path.loop else 1), 1)
    if count > MOST_SHOTS:
        raise UsageError(
            f"The camera path takes {path.seconds:,.0f} seconds, {count:,} pictures; a film has {MOST_SHOTS:,} at most. Give its "
            f"keyframes earlier seconds."
        )

    def shot(i: int) -> Shot:
        viewmat, time = path.at(i / fps)
        return time, replace(lens, viewmat=viewmat)

    return Shots(count, shot)


def film_through(start: Camera, cameras: Sequence[Camera], frames: int, fps: float, first: int = 0) -> Sequence[Shot]:
    """So many frames of a reel from `first` on, on a path from `start` through the cameras, the nearest next, with its lens.

    A start that stands where one of the cameras does passes it once. Without another camera it stays.
    """
    stops = in_order(start, cameras)
    leg = (frames - 1) / fps / max(len(stops) - 1, 1)
    if leg <= 0:
        stops = stops[:1]
    keyframes = [
        Keyframe(i * leg, first / fps + i * leg, stop.viewmat.astype(np.float64)) for i, stop in enumerate(stops)
    ]
    path = CameraPath(keyframes)
    return Shots(frames, lambda i: ((first + i) / fps, replace(start, viewmat=path.at(i / fps)[0])))


def starts_in_step(shots: Sequence[Shot], fps: float) -> float | None:
    """Seconds of the reel at which a film starts, if time goes at the reel's own pace all along, as its sound does; else None."""
    start = shots[0][0]
    return start if all(abs(seconds - start - i / fps) < 0.5 / fps for i, (seconds, _) in enumerate(shots)) else None


def write_film(
    path: Path, reel: Timeline, shots: Sequence[Shot], report: Callable[[int], None] = lambda done: None
) -> None:
    """Write pictures of a reel as H.264 in MP4, at the reel's rate, with its sound as AAC if it keeps step with them.

    The same pictures give the same bytes, and the film is there whole or not at all.

    All cameras have the same size; odd sides lose a row or column, as players expect. report: called with how many pictures are done.
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
        # Of several threads and of x264's macroblock tree the bytes depend on the machine and on what else it does.
        stream.options = {"crf": "17", "preset": "medium", "flags": "+bitexact", "x264-params": "mbtree=0"}
        start = starts_in_step(shots, reel.fps)
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
