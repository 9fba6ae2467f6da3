"""Complete videos, one per camera, and the alignment of their frames."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from splatreel import threads
from splatreel.capture.base import Request
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.growing.growing_sound import read_packets
from splatreel.capture.growing.growing_video import JUMP
from splatreel.capture.growing.growth import Growth, is_recorded
from splatreel.capture.growing.segmented_video import SegmentedVideo, numbered, segment_files
from splatreel.capture.sidecar import SIDECAR, Sidecar
from splatreel.capture.soundtrack import Track
from splatreel.capture.video import VideoFile
from splatreel.errors import CaptureError

CompleteVideo = VideoFile | SegmentedVideo

OUT_OF_STEP = 1.5
"""Maximum difference between the times of corresponding frames, in frames."""


class Videos:
    """Complete videos of a capture by camera: one file each, or one folder of numbered files each.

    By default all videos start together. With start times in the sidecar, each time step uses the frame nearest in
    time. Captures that were recorded to be followed (`is_recorded`) work the same way: cameras may miss frames, and the
    shortest camera ends the capture.

    Attributes:
        frames: Number of time steps that all videos have.
        fps: Time steps per second.

    Raises:
        CaptureError: Lengths or frame times of the videos differ, and no start times are given.
    """

    def __init__(self, path: Path, files: dict[str, Path], sidecar: Sidecar, request: Request) -> None:
        self._path, self._where, self._request = path, request.files, request
        with ThreadPoolExecutor(threads.count()) as pool:
            self._files = dict(zip(files, pool.map(self._opened, files.values()), strict=True))
        rates = [rate for video in self._files.values() if (rate := _rate(video))]
        self.fps = sidecar.fps or (float(np.median(rates)) if rates else 0.0) or 30.0
        unknown = [name for name in sidecar.starts if name not in self._files]
        if unknown:
            raise CaptureError(f"{path / SIDECAR}: says when {unknown[0]!r} starts, but no video is called so.")
        self._starts = sidecar.starts
        recorded = is_recorded(path) or any(isinstance(video, SegmentedVideo) for video in self._files.values())
        if recorded and not sidecar.fps:
            self.fps = round(self.fps, 3)  # the same rate as while it was followed
        self._by_time = recorded or bool(sidecar.starts)
        self._numbers = {name: self._frames_of(name, path) for name in self._files}
        counts = {name: len(numbers) for name, numbers in self._numbers.items()}
        self.frames = min(counts.values(), default=0)
        if request.frames is None and not self._by_time and len(set(counts.values())) > 1:
            low, high = min(counts, key=lambda n: counts[n]), max(counts, key=lambda n: counts[n])
            raise CaptureError(
                f"{path}: the videos have unequal frame counts: {files[low].name} has {counts[low]}, {files[high].name} has "
                f"{counts[high]}. If they start together, choose the frames all of them have: --frames 0:{counts[low]}. If they "
                f"do not, `splatreel capture sync` finds by their sound when each one starts."
            )
        if not self._by_time:
            self._check_times(path, self.frames if request.frames is None else min(request.frames[1], self.frames))
        for name in self._files:
            self._check_jump(name, None if request.frames is None else request.frames[1])

    def _opened(self, file: Path) -> CompleteVideo:
        tables = {self._path / name: table for name, table in self._request.tables.items()}
        if not file.is_dir():
            return VideoFile(file, self._where, tables.get(file))
        names = numbered(segment_files(file))
        if names is None:
            raise CaptureError(f"{file}: holds no videos. Copy them there, or leave the camera out.")
        video = SegmentedVideo(file, names, Growth.over(self._path), self._where, tables)
        absent, last = video.waiting_for, names.count - 1
        if self._request.frames is None and not absent.exists() and len(video.segments) < last:
            raise CaptureError(
                f"{absent}: is missing, though files up to {names.file(last).name} are there. Copy it there, or choose "
                f"those before: --frames 0:{video.frames}."
            )
        return video

    def __getitem__(self, name: str) -> CompleteVideo:
        return self._files[name]

    def _frames_of(self, name: str, path: Path) -> np.ndarray:
        """Return the frame of a video for each time step."""
        video = self._files[name]
        if not self._by_time:
            return np.arange(video.frames)
        times = video.times
        start, last = self._starts.get(name, 0.0), times[-1] if video.frames else -1.0
        if start > last:
            raise CaptureError(f"{path / SIDECAR}: {name} starts at {start:g} s, but its video ends at {last:g} s.")
        wanted = start + np.arange(int((last - start) * self.fps + 0.5) + 1) / self.fps
        return np.searchsorted((times[1:] + times[:-1]) / 2, wanted)  # nearest frame

    def _check_times(self, path: Path, frames: int) -> None:
        """Raise `CaptureError` if frames with the same number were not taken at the same time after the first frame."""
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

    def _check_jump(self, name: str, end: int | None) -> None:
        """Raise `CaptureError` if time steps before `end` lie after a jump of a video's clock."""
        video = self._files[name]
        jumps = np.flatnonzero(np.diff(video.times) > JUMP) if self._by_time else np.zeros(0, np.int64)
        failure = video.failure if isinstance(video, SegmentedVideo) else None
        if failure is None and not len(jumps):
            return
        last = float(video.times[jumps[0]] if len(jumps) else video.times[-1])
        steps = int((last - self._starts.get(name, 0.0)) * self.fps + 0.5) + 1
        if (self.frames if end is None else end) > steps or (end is None and failure is not None):
            raise CaptureError(
                f"{video.path}: its time jumps {last:.1f} s after its first frame, so that later frames cannot be placed. "
                f"Choose those before: --frames 0:{steps}."
            )

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Read time steps from `first` on of a camera into out [count, H, W, 3] uint8."""
        self._files[name].read_into(out, self._numbers[name][first : first + len(out)])

    def tracks(self, first: int) -> dict[str, Track]:
        """Return by camera the sound from time step `first` on, to the precision of the sidecar, not of a frame."""
        return {name: self._track(name, video, first) for name, video in self._files.items()}

    def _track(self, name: str, video: CompleteVideo, first: int) -> Track:
        seconds = self._starts.get(name, 0.0) + first / self.fps if self._by_time else float(video.times[first])
        if isinstance(video, VideoFile):
            return Track(video.path, seconds, self._where)
        return Track(video.written, seconds, self._where, lambda count: read_packets(video.sound(), count, seconds))

    def sources(self, first: int, count: int) -> list[Path]:
        """Return all videos, because each holds all of its time steps."""
        return [video.path for video in self._files.values()]

    def tables(self) -> dict[Path, FrameTable]:
        """Return the frame tables of all videos."""
        found: dict[Path, FrameTable] = {}
        for video in self._files.values():
            found |= {video.path: video.table} if isinstance(video, VideoFile) else video.tables
        return found

    def close(self) -> None:
        """Close open files."""
        for video in self._files.values():
            video.close()


def _rate(video: CompleteVideo) -> float:
    """Return the frames per second of a video; 0 if unknown. A jump of its clock would spoil the average that its file states."""
    steps = np.diff(video.times)
    return 1 / float(np.median(steps)) if steps.max(initial=0.0) > JUMP else video.fps
