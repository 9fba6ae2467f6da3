"""The toy room filmed by fourteen cameras, with sound, written as a Neu3DV folder.

Filming takes about a minute of a processor. The package therefore contains the film with the default arguments. `make film` writes it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from itertools import count
from pathlib import Path
from threading import Event

import av
import numpy as np

from splatreel.base import threads
from splatreel.base.errors import CaptureError, UsageError
from splatreel.base.new_folder import is_taken, new_folder
from splatreel.capture.builtin_film import FILM, copy_film, film_recipe
from splatreel.capture.capture_sound import RATE
from splatreel.capture.sidecar import SIDECAR
from splatreel.scene.camera import Camera, facing
from toyroom import room
from toyroom.raytracer import trace_frame, trace_static
from toyroom.sound import render_sound

VERSION = 4
"""Increase when the same arguments produce another capture."""

POSES = "poses_bounds.npy"
NEAR, FAR = 2.0, 9.0
"""Depth range of the visible content from every camera, world units."""
TARGET = np.array([0.0, 0.72, -0.25])
QUALITY = {"crf": "12", "preset": "veryslow", "tune": "psnr"}
"""Options of x264. Tuned for PSNR, the same error takes a quarter less than with the default, which adds grain that looks sharp."""
RADIUS = 4.5
HELD_OUT = {"cam00": (0.0, 15.0), "cam07": (-11.0, 18.0)}
"""Held-out cameras and their azimuth and elevation in degrees, between the rows and columns of training cameras."""
AZIMUTHS, ELEVATIONS = (-25.0, -15.0, -5.0, 5.0, 15.0, 25.0), (8.0, 24.0)


def make_cameras(width: int = 256, height: int = 192) -> list[Camera]:
    """Return fourteen cameras on a forward-facing arc of 50 by 16 degrees, cam00 to cam13."""
    training = [(a, e) for a in AZIMUTHS for e in ELEVATIONS]
    angles = dict(HELD_OUT)
    free = (f"cam{i:02d}" for i in range(len(training) + len(HELD_OUT)))
    angles.update(zip((n for n in free if n not in HELD_OUT), training, strict=True))
    return [_camera(name, *angles[name], width, height) for name in sorted(angles)]


def _camera(name: str, azimuth: float, elevation: float, width: int, height: int) -> Camera:
    a, e = math.radians(azimuth), math.radians(elevation)
    center = TARGET + RADIUS * np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])
    return facing(name, center, (TARGET - center) / RADIUS, 1.2 * max(width, height * 4 / 3), width, height)


def make_capture(
    path: str | Path,
    *,
    width: int = 256,
    height: int = 192,
    frames: int = 60,
    fps: int = 30,
    seed: int = 0,
    trace: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Path:
    """Film the toy room into a new Neu3DV folder, or copy the film that the package contains.

    The same arguments give the same bytes. An existing folder with the same capture is kept. No partial capture is left at `path`.

    Args:
        path: Output folder.
        width: Image width in pixels, even.
        height: Image height in pixels, even.
        frames: Number of frames.
        fps: Frames per second.
        seed: Variation of textures and small objects.
        trace: Film even if the package contains this film.
        progress: Called with the finished share, 0..1.

    Returns:
        The folder.

    Raises:
        UsageError: A size is invalid.
        CaptureError: `path` holds something else.
    """
    path = Path(path)
    if width < 16 or height < 16 or width % 2 or height % 2 or frames < 1 or fps < 1:
        raise UsageError(
            f"{width}x{height}, {frames} frames at {fps} fps: width and height must be even and at least 16."
        )
    recipe = {"version": VERSION, "width": width, "height": height, "frames": frames, "fps": fps, "seed": seed}
    if film_recipe(path) == recipe:
        return path
    refusal = CaptureError(f"{path}: exists and is not the film of {recipe}. Remove it or choose another folder.")
    if is_taken(path):
        raise refusal
    if not trace and film_recipe(FILM) == recipe:
        return copy_film(path)
    with new_folder(path, refusal) as made:
        _write(made.path, recipe, progress or (lambda share: None))
    return path


def _write(folder: Path, recipe: dict, progress: Callable[[float], None]) -> None:
    """Write all files of the capture, cameras in parallel."""
    cameras = make_cameras(recipe["width"], recipe["height"])
    total, done, stop = len(cameras) * recipe["frames"], count(1), Event()

    def film(camera: Camera) -> None:
        for _ in _film(folder, camera, recipe):
            progress(next(done) / total)
            if stop.is_set():
                return

    with ThreadPoolExecutor(threads.count()) as pool:
        try:
            for job in [pool.submit(film, camera) for camera in cameras]:
                job.result()
        except BaseException:  # only this thread receives Ctrl-C
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    np.save(folder / POSES, np.stack([llff_row(c, NEAR, FAR) for c in cameras]))
    sidecar = {"held_out": list(HELD_OUT), "fps": recipe["fps"], "made_by": recipe}
    (folder / SIDECAR).write_text(json.dumps(sidecar, indent=2) + "\n", encoding="utf-8")


def _film(folder: Path, camera: Camera, recipe: dict) -> Iterator[int]:
    """Write one camera's video and yield the number of each written frame."""
    still = room.standing(recipe["seed"])
    seen = trace_static(camera, still, room.LIGHT)
    seconds, seed = recipe["frames"] / recipe["fps"], 100 * recipe["seed"] + int(camera.name.removeprefix("cam"))
    sound = render_sound(camera.center, seconds, seed)
    with VideoWriter(folder / f"{camera.name}.mp4", camera, recipe["fps"], sound) as video:
        for t in range(recipe["frames"]):
            video.add(trace_frame(camera, seen, still, room.moving(t / recipe["fps"]), room.LIGHT))
            yield t


def llff_row(camera: Camera, near: float, far: float) -> np.ndarray:
    """Return a row of poses_bounds, [17] float64: 3x5 matrix of axes (down, right, backwards), center and size, then near and far."""
    right, down, forward = camera.viewmat[:3, :3].astype(np.float64)
    hwf = [camera.height, camera.width, camera.K[0, 0]]
    matrix = np.stack([down, right, -forward, camera.center, hwf], 1)
    return np.concatenate([matrix.ravel(), [near, far]])


class VideoWriter:
    """Writer of a nearly lossless H.264 file (45 dB). It uses one thread, so that the bytes do not depend on the machine.

    Args:
        path: Output file.
        camera: Camera whose size the images have.
        fps: Frames per second.
        sound: Samples [n] float32 at `RATE` per second from the first frame on, stored losslessly (FLAC); None means no
            sound.
        quality: Options of x264.
    """

    def __init__(
        self,
        path: Path,
        camera: Camera,
        fps: int,
        sound: np.ndarray | None = None,
        quality: Mapping[str, str] = QUALITY,
    ) -> None:
        self._container = av.open(str(path), "w", options={"fflags": "+bitexact"})
        self._stream = self._container.add_stream("libx264", rate=Fraction(fps))
        self._stream.width, self._stream.height, self._stream.pix_fmt = camera.width, camera.height, "yuv444p"
        self._stream.codec_context.thread_count = 1
        options = dict(quality) | {"g": str(2 * fps), "flags": "+bitexact"}
        options["x264-params"] = "mbtree=0"  # mbtree makes the bytes depend on load
        self._stream.codec_context.options = options
        self._sound = sound
        self._track = None
        if sound is not None:
            self._track = self._container.add_stream("flac", rate=RATE, layout="mono")
            self._track.codec_context.options = {"flags": "+bitexact", "compression_level": "12"}

    def __enter__(self) -> VideoWriter:
        return self

    def add(self, image: np.ndarray) -> None:
        """Add an image, uint8 [H, W, 3]."""
        self._container.mux(self._stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))

    def __exit__(self, kind: type | None, *_: object) -> None:
        if kind is None:
            self._container.mux(self._stream.encode(None))
            self._add_sound()
        self._container.close()

    def _add_sound(self) -> None:
        if self._sound is None or self._track is None:
            return
        samples = np.rint(self._sound * 32767).astype(np.int16)
        frame = av.AudioFrame.from_ndarray(samples[None], "s16", "mono")
        frame.sample_rate, frame.pts = RATE, 0
        self._container.mux(self._track.encode(frame))
        self._container.mux(self._track.encode(None))
