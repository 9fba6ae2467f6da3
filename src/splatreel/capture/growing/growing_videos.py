"""Growing videos of all cameras, and the alignment of their frames."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.capture_sound import Track
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.gaps import OUT_OF_STEP
from splatreel.capture.growing.growing_sound import Packets, read_packets
from splatreel.capture.growing.growing_video import GrowingVideo
from splatreel.capture.growing.growth import Growth
from splatreel.capture.growing.segmented_video import SegmentedVideo, numbered, segment_files
from splatreel.capture.sidecar import Sidecar
from splatreel.capture.video_color import VideoColor, video_conversions


class GrowingCamera(Protocol):
    """Complete frames of one camera: `GrowingVideo` or `SegmentedVideo`."""

    path: Path
    width: int
    height: int
    fps: float
    failure: str | None
    color: VideoColor

    @property
    def written(self) -> Path:
        """File that can be read already."""
        ...

    @property
    def last(self) -> float | None:
        """Seconds from the first frame to the last complete one."""
        ...

    @property
    def waiting_for(self) -> Path:
        """File of the next frame."""
        ...

    def update(self) -> None:
        """Report finished steps."""

    def settle(self) -> None:
        """Count everything that exists, after the capture has ended."""

    def numbers(self, wanted: np.ndarray) -> np.ndarray:
        """Return the number of the frame nearest to each time."""
        ...

    def frame_times(self, numbers: np.ndarray) -> np.ndarray:
        """Return the times of frames in seconds after the first frame."""
        ...

    def read_into(self, out: np.ndarray, numbers: np.ndarray) -> None:
        """Decode frames with ascending numbers into an array."""

    def sound(self) -> Packets:
        """Yield the packets of the sound track."""
        ...

    def close(self) -> None:
        """Stop reading."""


class GrowingVideos:
    """Growing videos of a capture by camera. Frames are aligned by time, as `Videos` does with start times.

    Videos start together, or at the times in the sidecar. A frame that a camera missed is replaced by the nearest one.
    The frame rate is the sidecar's, or the median of the files'.

    Args:
        path: Folder of the capture.
        files: Video, or folder of numbered videos, by camera.
        sidecar: Content of `splatreel.json`.
        growth: State of the capture.
    """

    def __init__(self, path: Path, files: dict[str, Path], sidecar: Sidecar, growth: Growth) -> None:
        self.path = path
        self._cameras: dict[str, GrowingCamera] = {}
        try:
            for name, file in files.items():
                self._cameras[name] = _camera(file, growth, sidecar.transfer)
        except BaseException:
            self.close()
            raise
        rates = [camera.fps for camera in self._cameras.values() if camera.fps]
        self.fps = sidecar.fps or round(float(np.median(rates)) if rates else 30.0, 3)
        self._starts = sidecar.starts
        self._speeds = sidecar.rates
        self.notes: list[str] = []

    def __getitem__(self, name: str) -> GrowingCamera:
        return self._cameras[name]

    @property
    def frames(self) -> int:
        """Number of time steps complete in all cameras."""
        return min(self.counts().values(), default=0)

    def counts(self) -> dict[str, int]:
        """Return the number of complete time steps by camera."""
        return {name: self._count(name, camera.last) for name, camera in self._cameras.items()}

    def waiting_for(self, name: str) -> Path:
        """Return the file of a camera's next frame."""
        return self._cameras[name].waiting_for

    def failure(self, name: str) -> str | None:
        """Return the reason why no more frames of a camera will be read; None while there is none."""
        camera = self._cameras[name]
        return None if camera.failure is None else f"{camera.path}: {camera.failure}"

    def update(self) -> None:
        """Check for new frames."""
        for camera in self._cameras.values():
            camera.update()

    def settle(self) -> None:
        """Count everything that exists, after the capture has ended."""
        for camera in self._cameras.values():
            camera.settle()

    def size(self, name: str, calibrated: tuple[int, int] | None = None) -> tuple[int, int]:
        """Return width and height of a camera's images."""
        return self._cameras[name].width, self._cameras[name].height

    def conversions(self) -> list[str]:
        """Return sentences about conversions of the images that users should know of."""
        return video_conversions(self._cameras)

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Read time steps from `first` on of a camera into out [count, H, W, 3] uint8."""
        wanted = self._times(name, first, len(out))
        camera = self._cameras[name]
        camera.read_into(out, camera.numbers(wanted))

    def missing(self, first: int, count: int, name: str) -> np.ndarray:
        """Return [count] bool, the time steps for which a camera has no frame. The nearest frame stands in for it."""
        wanted = self._times(name, first, count)
        camera = self._cameras[name]
        return np.abs(camera.frame_times(camera.numbers(wanted)) - wanted) * self.fps > OUT_OF_STEP

    def sources(self, first: int, count: int) -> list[Path]:
        """Return the files that are read."""
        return [camera.path for camera in self._cameras.values()]

    def tables(self) -> dict[Path, FrameTable]:
        """Return nothing, because more frames will follow."""
        return {}

    def tracks(self, first: int) -> dict[str, Track]:
        """Return by camera a written file that may have sound. `sound` follows it."""
        return {name: Track(camera.written, 0.0) for name, camera in self._cameras.items()}

    def sound(self, name: str, channels: int, first: int, seconds: float) -> Iterator[np.ndarray]:
        """Yield a camera's sound in blocks [n, channels] float32 at 48 kHz, from `seconds` after time step `first` on."""
        start = self._starts.get(name, 0.0) + self._speeds.get(name, 1.0) * (first / self.fps + seconds)
        yield from read_packets(self._cameras[name].sound(), channels, start)

    def close(self) -> None:
        """Stop reading."""
        for camera in self._cameras.values():
            camera.close()

    def _count(self, name: str, last: float | None) -> int:
        start = self._starts.get(name, 0.0)
        speed = self._speeds.get(name, 1.0)
        return 0 if last is None or last < start else int((last - start) / speed * self.fps + 0.5) + 1

    def _times(self, name: str, first: int, count: int) -> np.ndarray:
        """Return the times of time steps in a camera's video, [count] seconds."""
        steps = (first + np.arange(count)) / self.fps
        return self._starts.get(name, 0.0) + self._speeds.get(name, 1.0) * steps


def _camera(file: Path, growth: Growth, transfer: str | None) -> GrowingCamera:
    if not file.is_dir():
        return GrowingVideo(file, growth, transfer)
    names = numbered(segment_files(file))
    if names is None:
        raise CaptureError(f"{file}: holds no videos yet.")
    return SegmentedVideo(file, names, growth, transfer=transfer)
