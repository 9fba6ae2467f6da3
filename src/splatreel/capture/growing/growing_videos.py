"""A video a camera, all of which are still being written, and which of their frames belong together."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np

from splatreel.capture.frame_table import FrameTable
from splatreel.capture.growing.growing_sound import Packets, read_packets
from splatreel.capture.growing.growing_video import GrowingVideo
from splatreel.capture.growing.growth import Growth
from splatreel.capture.growing.segmented_video import SegmentedVideo, numbered, segment_files
from splatreel.capture.sidecar import Sidecar
from splatreel.capture.soundtrack import Track
from splatreel.errors import CaptureError


class GrowingCamera(Protocol):
    """The frames of one camera, as far as they are whole: `GrowingVideo` or `SegmentedVideo`."""

    path: Path
    width: int
    height: int
    fps: float

    @property
    def written(self) -> Path: ...
    @property
    def last(self) -> float | None: ...
    @property
    def waiting_for(self) -> Path: ...
    def update(self) -> None: ...
    def settle(self) -> None: ...
    def numbers(self, wanted: np.ndarray) -> np.ndarray: ...
    def read_into(self, out: np.ndarray, numbers: np.ndarray) -> None: ...
    def sound(self) -> Packets: ...
    def close(self) -> None: ...


class GrowingVideos:
    """The videos of a capture, by camera; frames are taken by their times, as `Videos` does where a sidecar says when they start.

    They start together, or when the sidecar says. A frame that a camera missed is the one nearest to its time.
    fps: what the sidecar says, or the median of what the files do. files: a video, or a folder of numbered ones, by camera.
    """

    def __init__(self, path: Path, files: dict[str, Path], sidecar: Sidecar, growth: Growth) -> None:
        self.path = path
        self._cameras: dict[str, GrowingCamera] = {}
        try:
            for name, file in files.items():
                self._cameras[name] = _camera(file, growth)
        except BaseException:
            self.close()
            raise
        rates = [camera.fps for camera in self._cameras.values() if camera.fps]
        self.fps = sidecar.fps or round(float(np.median(rates)) if rates else 30.0, 3)
        self._starts = sidecar.starts

    def __getitem__(self, name: str) -> GrowingCamera:
        return self._cameras[name]

    @property
    def frames(self) -> int:
        """Time steps that are whole in all cameras."""
        return min(self.counts().values(), default=0)

    def counts(self) -> dict[str, int]:
        """By camera, how many time steps of it are whole."""
        return {name: self._count(name, camera.last) for name, camera in self._cameras.items()}

    def waiting_for(self, name: str) -> Path:
        """The file in which a camera's next frame will be."""
        return self._cameras[name].waiting_for

    def update(self) -> None:
        """Look for what was written."""
        for camera in self._cameras.values():
            camera.update()

    def settle(self) -> None:
        """Once the capture has ended: all that is there counts."""
        for camera in self._cameras.values():
            camera.settle()

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Time steps first .. first + len(out) - 1 of a camera into out [count, H, W, 3] uint8."""
        wanted = self._starts.get(name, 0.0) + (first + np.arange(len(out))) / self.fps
        camera = self._cameras[name]
        camera.read_into(out, camera.numbers(wanted))

    def sources(self, first: int, count: int) -> list[Path]:
        return [camera.path for camera in self._cameras.values()]

    def tables(self) -> dict[Path, FrameTable]:
        """Nothing: more frames are to come."""
        return {}

    def tracks(self, first: int) -> dict[str, Track]:
        """By camera, a file that is written and may have sound. It is followed by `sound`."""
        return {name: Track(camera.written, 0.0) for name, camera in self._cameras.items()}

    def sound(self, name: str, channels: int, first: int, seconds: float) -> Iterator[np.ndarray]:
        """That of a camera, in blocks [n, channels] float32 of 48 kHz, from so many seconds after time step `first` on."""
        start = self._starts.get(name, 0.0) + first / self.fps + seconds
        yield from read_packets(self._cameras[name].sound(), channels, start)

    def close(self) -> None:
        for camera in self._cameras.values():
            camera.close()

    def _count(self, name: str, last: float | None) -> int:
        start = self._starts.get(name, 0.0)
        return 0 if last is None or last < start else int((last - start) * self.fps + 0.5) + 1


def _camera(file: Path, growth: Growth) -> GrowingCamera:
    if not file.is_dir():
        return GrowingVideo(file, growth)
    names = numbered(segment_files(file))
    if names is None:
        raise CaptureError(f"{file}: holds no videos yet.")
    return SegmentedVideo(file, names, growth)
