"""Captures written step by step, as cameras do."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image

from splatreel.capture.growth import END
from tests.capture import folders

RATE = 48_000
CONTAINERS: dict[str, tuple[str, dict[str, str]]] = {
    "mkv": ("matroska", {"flush_packets": "1", "cluster_time_limit": "200"}),
    "ts": ("mpegts", {"flush_packets": "1"}),
    "mp4": ("mp4", {"flush_packets": "1", "movflags": "frag_keyframe+delay_moov+default_base_moof"}),
}
"""Options that make each kind of file readable while it grows."""
KINDS = (*CONTAINERS, "segments", "pictures")

DrawImage = Callable[[int, int], np.ndarray]
"""Function from a camera and a frame to an image, uint8 [H, W, 3]."""


def mark(camera: int, number: int) -> np.ndarray:
    """Return a flat image whose color encodes camera and frame, uint8 [H, W, 3]."""
    return np.full((folders.HEIGHT, folders.WIDTH, 3), (10 + 5 * number, 40 + 40 * camera, 128), np.uint8)


def marks(image: np.ndarray) -> tuple[int, int]:
    """Return the cameras and frames that the colors of images of `mark` encode."""
    red, green, _ = image.reshape(-1, 3).mean(0)
    return round((green - 40) / 40), round((red - 10) / 5)


class Video:
    """Writer of one file. `sound` returns the samples [n] float32 at `RATE` for a frame's time."""

    def __init__(
        self, path: Path, kind: str, fps: int, first: int = 0, sound: Callable[[int], np.ndarray] | None = None
    ):
        name, options = CONTAINERS.get(kind, (path.suffix[1:], {}))
        self._container = av.open(str(path), "w", format=name, options=options)
        self._stream: Any = self._container.add_stream("libx264", rate=fps)
        self._stream.pix_fmt = "yuv444p"
        self._stream.codec_context.options = {"crf": "1", "g": "5", "preset": "ultrafast", "tune": "zerolatency"}
        self._track: Any = self._container.add_stream("aac", rate=RATE, layout="mono") if sound else None
        self._sound, self._rest, self._heard = sound, np.zeros(0, np.float32), 0
        self._frame = self._first = first

    def add(self, image: np.ndarray) -> None:
        if self._frame == self._first:
            self._stream.height, self._stream.width = image.shape[:2]
        encoded = av.VideoFrame.from_ndarray(image, format="rgb24")
        encoded.pts = self._frame - self._first
        self._container.mux(self._stream.encode(encoded))
        if self._sound is not None:
            self._rest = np.concatenate([self._rest, self._sound(self._frame)])
            while len(self._rest) >= 1024:
                self._hear()
        self._frame += 1

    def _hear(self) -> None:
        part, self._rest = self._rest[:1024], self._rest[1024:]
        frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(part[None]), "fltp", "mono")
        frame.sample_rate, frame.pts = RATE, self._heard
        self._heard += len(part)
        self._container.mux(self._track.encode(frame))

    def skip(self, frames: int) -> None:
        """Record nothing for some frames."""
        self._frame += frames

    def close(self) -> None:
        if len(self._rest):
            self._hear()
        for stream in filter(None, (self._stream, self._track)):
            self._container.mux(stream.encode(None))
        self._container.close()


class Recorder:
    """Writer of all cameras of a capture.

    Poses are those of `folders.cameras` by default. `segment` is the number of frames per file for numbered files.
    `sound` returns the sound of a frame's time for the first camera.
    """

    def __init__(
        self,
        folder: Path,
        kind: str,
        draw: DrawImage = mark,
        *,
        cameras: list | None = None,
        fps: int = 10,
        segment: int = 4,
        sound: Callable[[int], np.ndarray] | None = None,
    ) -> None:
        self.folder, self.kind, self.draw, self.fps, self.segment, self.sound = (
            folder,
            kind,
            draw,
            fps,
            segment,
            sound,
        )
        self.views = cameras or folders.cameras()
        self.written = dict.fromkeys(range(len(self.views)), 0)
        self._videos: dict[int, Video] = {}
        folder.mkdir(exist_ok=True)
        if kind == "pictures":
            folders.colmap_model(folder, self.views)
        else:
            np.save(folder / "poses_bounds.npy", folders.llff(self.views))

    def write(self, frames: int, but: tuple[int, ...] = ()) -> None:
        """Write frames of all cameras except some."""
        for _ in range(frames):
            for camera in self.written:
                if camera not in but:
                    self._write(camera)

    def lose(self, camera: int, frames: int) -> None:
        """Drop frames of a camera."""
        self._videos[camera].skip(frames)
        self.written[camera] += frames

    def jump(self, camera: int, frames: int) -> None:
        """Set the clock of a camera forward. No frames are lost."""
        self._videos[camera].skip(frames)

    def end(self) -> None:
        """Complete all files and write the end mark."""
        for video in self._videos.values():
            video.close()
        self._videos.clear()
        (self.folder / END).touch()

    def _write(self, camera: int) -> None:
        number, name = self.written[camera], self.views[camera].name
        image = self.draw(camera, number)
        self.written[camera] += 1
        if self.kind == "pictures":
            place = self.folder / "images" / name
            place.mkdir(parents=True, exist_ok=True)
            Image.fromarray(image).save(place / f"{number:06d}.png")
            return
        if self.kind == "segments" and number % self.segment == 0 and camera in self._videos:
            self._videos.pop(camera).close()
        if camera not in self._videos:
            self._videos[camera] = self._open(camera, name, number)
        self._videos[camera].add(image)

    def _open(self, camera: int, name: str, number: int) -> Video:
        sound = self.sound if camera == 0 else None
        if self.kind != "segments":
            return Video(self.folder / f"{name}.{self.kind}", self.kind, self.fps, number, sound)
        (self.folder / name).mkdir(exist_ok=True)
        return Video(self.folder / name / f"{number // self.segment:06d}.mp4", "segments", self.fps, number, sound)
