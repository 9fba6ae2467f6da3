"""A reel as an ordinary video: rendered on the CPU, a frame at a time, along a path of cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from splatreel.play.timeline import Timeline
from splatreel.scene.camera import Camera


def camera_path(start: Camera, cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """From `start` through the cameras, the nearest next, in `frames` smooth steps; every step has the lens of `start`.

    A start that stands where one of the cameras does passes it once. Without another camera it stays.
    """
    stops = [start]
    left = [c for c in cameras if np.linalg.norm(c.center - start.center) > 1e-6]
    while left:
        distances = [np.linalg.norm(c.center - stops[-1].center) for c in left]
        stops.append(left.pop(int(np.argmin(distances))))
    if len(stops) == 1:
        return stops * frames
    times = np.arange(len(stops))
    now = np.linspace(0, len(stops) - 1, frames)
    centers = CubicSpline(times, [c.center for c in stops])(now)
    turns = RotationSpline(times, Rotation.from_matrix([c.viewmat[:3, :3] for c in stops]))(now).as_matrix()
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, :3, :3] = turns
    poses[:, :3, 3] = -(turns @ centers[..., None])[..., 0]
    return [replace(start, viewmat=pose) for pose in poses]


def write_film(
    path: Path,
    reel: Timeline,
    cameras: Sequence[Camera],
    first: int = 0,
    report: Callable[[int], None] = lambda done: None,
) -> None:
    """Write frames `first`, `first + 1`, ... of a reel as H.264 in MP4, one a camera; all cameras have the same size.

    Odd sides lose a row or column, as players expect. report: called with how many frames are done.
    """
    width, height = cameras[0].width // 2 * 2, cameras[0].height // 2 * 2
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(reel.fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"crf": "17", "preset": "medium"}
        for done, camera in enumerate(cameras):
            image = reel.render(reel.at((first + done) / reel.fps), camera)
            pixels = np.rint(np.clip(image[:height, :width], 0, 1) * 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), "rgb24")))
            report(done + 1)
        container.mux(stream.encode())
