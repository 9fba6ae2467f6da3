"""One video a camera, and which of their frames were taken together."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.capture.base import Request
from splatreel.capture.sidecar import SIDECAR, Sidecar
from splatreel.capture.sound import Track
from splatreel.capture.video import VideoFile
from splatreel.errors import CaptureError

OUT_OF_STEP = 1.5
"""Frames that the times of videos' frames may differ by."""


class Videos:
    """The videos of a capture, by camera.

    They start together, or when the sidecar says: then each frame is the one taken nearest to its time. frames: how many time steps
    all of them have. fps: of the capture.
    Raises `CaptureError` where their lengths differ, or the times of their frames, and nothing says how they belong together.
    """

    def __init__(self, path: Path, files: dict[str, Path], sidecar: Sidecar, request: Request) -> None:
        self._files = {name: VideoFile(file) for name, file in files.items()}
        rates = [video.fps for video in self._files.values()]
        self.fps = sidecar.fps or (float(np.median(rates)) if rates else 0.0) or 30.0
        unknown = [name for name in sidecar.starts if name not in self._files]
        if unknown:
            raise CaptureError(f"{path / SIDECAR}: says when {unknown[0]!r} starts, but no video is called so.")
        self._starts = sidecar.starts
        self._numbers = {name: self._frames_of(name, sidecar, path) for name in self._files}
        counts = {name: len(numbers) for name, numbers in self._numbers.items()}
        self.frames = min(counts.values(), default=0)
        if request.frames is None and not sidecar.starts and len(set(counts.values())) > 1:
            low, high = min(counts, key=lambda n: counts[n]), max(counts, key=lambda n: counts[n])
            raise CaptureError(
                f"{path}: the videos have unequal frame counts: {files[low].name} has {counts[low]}, {files[high].name} has "
                f"{counts[high]}. If they start together, choose the frames all of them have: --frames 0:{counts[low]}. If they "
                f"do not, `splatreel capture sync` finds by their sound when each one starts."
            )
        if not sidecar.starts:
            self._check_times(path, self.frames if request.frames is None else min(request.frames[1], self.frames))

    def __getitem__(self, name: str) -> VideoFile:
        return self._files[name]

    def _frames_of(self, name: str, sidecar: Sidecar, path: Path) -> np.ndarray:
        """Which frame of a video is shown at each time step."""
        video = self._files[name]
        if not sidecar.starts:
            return np.arange(video.frames)
        start, last = sidecar.starts.get(name, 0.0), video.times[-1] if video.frames else -1.0
        if start > last:
            raise CaptureError(f"{path / SIDECAR}: {name} starts at {start:g} s, but its video ends at {last:g} s.")
        wanted = start + np.arange(int((last - start) * self.fps + 0.5) + 1) / self.fps
        return np.searchsorted((video.times[1:] + video.times[:-1]) / 2, wanted)  # the nearest

    def _check_times(self, path: Path, frames: int) -> None:
        """Frames of one number count as taken together, and so must have been, each as long after its video's first."""
        names = list(self._files)
        times = np.stack([self._files[name].times[:frames] for name in names]) if names else np.zeros((0, 0))
        off = np.abs(times - np.median(times, 0)) * self.fps if times.size else times
        if off.max(initial=0) > OUT_OF_STEP:
            video, frame = np.unravel_index(np.argmax(off > OUT_OF_STEP), off.shape)
            own, others = times[video, frame], np.median(times, 0)[frame]
            raise CaptureError(
                f"{self._files[names[video]].path}: frame {frame} is of {own:.3f} s, that of the others of {others:.3f} s: frames "
                f"are missing, or the rate is another. Choose those before (--frames 0:{frame}), or say in {path / SIDECAR} when each "
                f"video starts, as `splatreel capture sync` does by their sound: frames are then taken by their times."
            )

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Time steps first .. first + len(out) - 1 of a camera into out [count, H, W, 3] uint8."""
        self._files[name].read_into(out, self._numbers[name][first : first + len(out)])

    def tracks(self, first: int) -> dict[str, Track]:
        """By camera, where its sound from time step `first` on is: to the millisecond that the sidecar says, not to a frame."""
        if self._starts:
            seconds = {name: self._starts.get(name, 0.0) + first / self.fps for name in self._files}
        else:
            seconds = {name: float(video.times[first]) for name, video in self._files.items()}
        return {name: Track(video.path, seconds[name]) for name, video in self._files.items()}

    def sources(self, first: int, count: int) -> list[Path]:
        """All videos: each holds all of its time steps."""
        return [video.path for video in self._files.values()]

    def close(self) -> None:
        for video in self._files.values():
            video.close()
