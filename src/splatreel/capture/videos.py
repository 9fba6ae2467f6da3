"""Videos of a capture, one per camera or in numbered parts: complete ones, and ones that are still being written."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from statistics import median_low
from typing import Generic, Protocol, TypeVar

import numpy as np

from splatreel.base import threads
from splatreel.base.errors import CaptureError
from splatreel.capture.base import Request
from splatreel.capture.capture_sound import Track
from splatreel.capture.color import VideoColor, video_conversions
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.growing_video import JUMP, GrowingVideo, Packets, read_packets
from splatreel.capture.growth import Growth, is_recorded
from splatreel.capture.segmented_video import SegmentedVideo, numbered, segment_files
from splatreel.capture.sidecar import SIDECAR, Sidecar
from splatreel.capture.time_steps import OUT_OF_STEP, OwnFrames, describe_gaps, used_steps
from splatreel.capture.video import VideoFile

CompleteVideo = VideoFile | SegmentedVideo

LATE_END = 1.5
"""Maximum difference between the ends of videos that start together, in frames."""
SLOWED = 1.5
"""Minimum ratio of the rate at which a camera states to have filmed and that of the video for slow motion."""
SLOW_MOTION, SAME_FACTOR = (2, 4, 5, 8, 10, 16), 0.02
"""Usual ratios of slow motion, and the maximum relative difference from one."""
SAME_CLOCK = 1.0
"""Maximum difference in seconds between the first timestamps of videos for these to be compared. Larger ones are of clocks that
differ."""


V = TypeVar("V", "CompleteVideo", "GrowingCamera")


class _CameraVideos(Generic[V]):
    """Videos of a capture by camera."""

    _files: dict[str, V]

    def __getitem__(self, name: str) -> V:
        return self._files[name]

    def size(self, name: str, calibrated: tuple[int, int] | None = None) -> tuple[int, int]:
        """Return width and height of a camera's images."""
        return self._files[name].width, self._files[name].height

    def conversions(self) -> list[str]:
        """Return sentences about conversions of the images that users should know of."""
        return video_conversions(self._files)

    def sources(self, first: int, count: int) -> list[Path]:
        """Return all videos, because each holds all of its time steps."""
        return [video.path for video in self._files.values()]

    def close(self) -> None:
        """Close open files, and stop reading."""
        for video in self._files.values():
            video.close()


class Videos(_CameraVideos[CompleteVideo]):
    """Complete videos of a capture by camera: one file each, or one folder of numbered files each.

    Each time step uses the frame of each video that is nearest by its timestamps. A camera without a near frame misses the
    time step, and the others are not affected. By default all videos start together. The sidecar may give start times.
    In captures that were recorded to be followed (`is_recorded`), the shortest camera ends the capture.

    Raises:
        CaptureError: The videos end at different times, and neither start times nor frames are given. Or one of the
            frames that are given is not whole.
    """

    def __init__(self, path: Path, files: dict[str, Path], sidecar: Sidecar, request: Request) -> None:
        self._path = path
        self._where = request.files
        self._request = request
        self._transfer = sidecar.transfer
        self.notes: list[str] = []
        self._files = dict(zip(files, threads.map_parallel(self._opened, files.values()), strict=True))
        unknown = [name for name in (*sidecar.starts, *sidecar.rates) if name not in self._files]
        if unknown:
            raise CaptureError(f"{path / SIDECAR}: says when {unknown[0]!r} starts, but no video is called so.")
        recorded = is_recorded(path) or any(
            isinstance(video, SegmentedVideo) and not video.is_complete for video in self._files.values()
        )
        rates = {
            name: video.fps if recorded and _jump(video) is None else frame_rate(video)
            for name, video in self._files.items()
        }
        known = [rate for rate in rates.values() if rate]
        rate = median_low(known) if known else 30.0
        if recorded and known:  # the same rate as while it was followed
            rate = round(float(np.median(known)), 3)
        self.fps = sidecar.fps or rate
        # Without start times, the sidecar's rate is the true one of videos that play at another speed.
        self._step = 1 / (self.fps if sidecar.starts or recorded else rate)
        self._starts = dict.fromkeys(self._files, 0.0) | sidecar.starts
        self._speeds = dict.fromkeys(self._files, 1.0) | sidecar.rates
        if not sidecar.starts and not recorded:
            self._starts |= self._first_times()
        for name in self._files:
            self._check_jump(name, None if request.frames is None else request.frames[1])
        self._pair(recorded)
        if request.frames is not None:
            self._check_truncated(request.frames[1])
        if not sidecar.starts and not recorded and request.frames is None:
            self._check_ends()
        self.notes += [*describe_rates(rates, 1 / self._step), *_describe_slow_motion(self._files)]

    def _opened(self, file: Path) -> CompleteVideo:
        tables = {self._path / name: table for name, table in self._request.tables.items()}
        partial = self._request.frames is not None
        if not file.is_dir():
            return VideoFile(file, self._where, tables.get(file), self._transfer, partial)
        parts = segment_files(file)
        if len(parts) == 1 and not is_recorded(self._path):
            return VideoFile(parts[0], self._where, tables.get(parts[0]), self._transfer, partial)
        names = numbered(parts)
        if names is None:
            raise CaptureError(f"{file}: holds no videos. Copy them there, or leave the camera out.")
        video = SegmentedVideo(file, names, Growth.over(self._path), self._where, tables, self._transfer)
        if len(video.segments) < len(parts) and not video.waiting_for.exists():
            raise CaptureError(
                f"{video.waiting_for}: is missing, though later ones exist. Copy it there, or leave the camera out."
            )
        return video

    def _first_times(self) -> dict[str, float]:
        """Return start times, 0 or less, for videos whose first timestamps are later than those of others by half a frame."""
        first = {
            name: video.start
            for name, video in self._files.items()
            if isinstance(video, VideoFile) and not video.table.counted
        }
        apart = {name: start - min(first.values()) for name, start in first.items()}
        late = max(apart, key=lambda name: apart[name], default="")
        if not late or apart[late] < 0.5 * self._step:
            return {}
        if apart[late] > SAME_CLOCK:
            self.notes.append(
                f"the first timestamps differ by up to {apart[late]:.3g} s ({late}) and are not compared: videos are taken to start "
                f"together. If they do not, run `splatreel capture sync`"
            )
            return {}
        self.notes.append(f"{late} starts {apart[late]:.3f} s after the first video, by its timestamps")
        return {name: -start for name, start in apart.items()}

    def _pair(self, recorded: bool) -> None:
        """Find the frame of every video for each time step, and the time steps to use."""
        clocks = {
            name: (video.times[: _jump(video)] - self._starts[name]) / self._speeds[name]
            for name, video in self._files.items()
        }
        for name, clock in clocks.items():
            if not len(clock) or clock[-1] < 0:
                start = self._starts[name]
                last = clock[-1] * self._speeds[name] + start if len(clock) else 0.0
                raise CaptureError(
                    f"{self._path / SIDECAR}: {name} starts at {start:g} s, but its video ends at {last:g} s."
                )
        ends = [int(clock[-1] / self._step + 0.5) + 1 for clock in clocks.values()]
        wanted = np.arange(max(ends, default=0)) * self._step
        numbers = {name: np.searchsorted((clock[1:] + clock[:-1]) / 2, wanted) for name, clock in clocks.items()}
        exists = {
            name: np.abs(clock[numbers[name]] - wanted) <= OUT_OF_STEP * self._step for name, clock in clocks.items()
        }
        first, end = used_steps(exists)
        if recorded:
            first, end = 0, min(ends, default=0)
        self._first_step = first
        self.frames = end - first
        self._numbers = {name: found[first:end] for name, found in numbers.items()}
        self._lacks = {name: ~found[first:end] for name, found in exists.items()}
        self._ends = {name: end - first for name, end in zip(clocks, ends, strict=True)}
        self.notes += describe_gaps(self._lacks, range(self.frames), "frames")

    def _check_ends(self) -> None:
        if not self._ends or max(self._ends.values()) - min(self._ends.values()) <= LATE_END:
            return
        low, high = min(self._ends, key=lambda n: self._ends[n]), max(self._ends, key=lambda n: self._ends[n])
        least = self._ends[low]
        rest = f", and --frames 0:{self.frames} those that most have" if self.frames > least else ""
        counts = ", ".join(self._described_end(name) for name in (low, high))
        whole = all(self._files[name].frames == self._ends[name] for name in (low, high))
        problem = "have unequal frame counts" if whole else "end at different times"
        raise CaptureError(
            f"{self._path}: the videos {problem}: {counts}. If they start together, --frames 0:{least} chooses the "
            f"frames all of them have{rest}. If they do not, `splatreel capture sync` finds by their sound when each one starts."
        )

    def _described_end(self, name: str) -> str:
        """Return the number of frames of a video, and the time steps that they cover if these are more or fewer."""
        video, steps = self._files[name], self._ends[name]
        if video.frames == steps:
            return f"{video.path.name} has {steps}"
        return f"{video.path.name} has {video.frames} frames, which span {steps} time steps"

    def _check_truncated(self, end: int) -> None:
        """Raise `CaptureError` if a truncated video ends before time step `end`. Otherwise, name the video."""
        for name, video in self._files.items():
            if isinstance(video, VideoFile) and video.truncation:
                steps = self._ends[name]
                if end > steps:
                    raise CaptureError(
                        f"{video.truncation}. Copy the file again, choose frames before its end (--frames 0:{steps}), or leave the "
                        f"camera out."
                    )
                self.notes.append(f"{video.truncation}, which are used")

    def _check_jump(self, name: str, end: int | None) -> None:
        """Raise `CaptureError` if time steps before `end` lie after a jump of a video's clock."""
        video = self._files[name]
        jump = _jump(video)
        if jump is None:
            return
        last = float(video.times[jump - 1])
        steps = int((last - self._starts[name]) / self._speeds[name] / self._step + 0.5) + 1
        if end is None or end > steps:
            raise CaptureError(
                f"{video.path}: its time jumps {last:.1f} s after its first frame, so that later frames cannot be placed. "
                f"Choose those before: --frames 0:{steps}."
            )

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Read time steps from `first` on of a camera into out [count, H, W, 3] uint8."""
        self._files[name].read_into(out, self._numbers[name][first : first + len(out)])

    def missing(self, first: int, count: int, name: str) -> np.ndarray:
        """Return [count] bool, the time steps for which a camera has no frame. The nearest frame stands in for it."""
        return self._lacks[name][first : first + count]

    def own_frames(self, name: str) -> OwnFrames:
        """Return the frames that a camera's video has."""
        return OwnFrames(self._numbers[name], self._files[name].frames)

    def tracks(self, first: int) -> dict[str, Track]:
        """Return by camera the sound from time step `first` on, to the precision of the sidecar, not of a frame."""
        return {name: self._track(name, video, first) for name, video in self._files.items()}

    def _track(self, name: str, video: CompleteVideo, first: int) -> Track:
        seconds = self._starts[name] + self._speeds[name] * (self._first_step + first) * self._step
        if isinstance(video, VideoFile):
            return Track(video.path, seconds, self._where, speed=self._speeds[name])
        return Track(video.written, seconds, self._where, lambda count: read_packets(video.sound(), count, seconds))

    def tables(self) -> dict[Path, FrameTable]:
        """Return the frame tables of all videos."""
        found: dict[Path, FrameTable] = {}
        for video in self._files.values():
            found |= {video.path: video.table} if isinstance(video, VideoFile) else video.tables
        return found


def frame_rate(video: CompleteVideo) -> float:
    """Return the frames per second of a video, not lowered by missing frames; 0 if unknown."""
    times = video.times
    if len(times) < 3 or times[-1] <= 0:
        return video.fps
    gaps = np.diff(times)
    steps = int(np.maximum(np.rint(gaps / np.median(gaps)), 1).sum())
    if steps == len(gaps) and abs(times[-1] * video.fps - steps) < 0.1:
        return video.fps  # exact, unlike times in milliseconds
    return steps / float(times[-1])


def describe_rates(rates: dict[str, float], used: float) -> list[str]:
    """Return a sentence about cameras with another frame rate than the capture's."""
    other = {name: rate for name, rate in rates.items() if rate and abs(rate / used - 1) > 0.02}
    if not other:
        return []
    found = ", ".join(f"{name} {rate:.4g}" for name, rate in other.items())
    return [f"{used:.4g} frames a second are used; others have {found}, of which the frames nearest in time are read"]


def _describe_slow_motion(files: dict[str, CompleteVideo]) -> list[str]:
    """Return sentences about videos that were filmed faster than they play, by what the camera states or by their sound."""
    stated: dict[tuple[float, float], list[str]] = {}
    likely = {}
    for name, video in files.items():
        rate = frame_rate(video)
        if not isinstance(video, VideoFile) or not rate or len(video.times) < 2:
            continue
        length = float(video.times[-1]) + 1 / rate
        if video.table.filmed > SLOWED * rate:
            stated.setdefault((video.table.filmed, rate), []).append(name)
        elif video.table.sound_seconds > 0 and any(
            abs(length / video.table.sound_seconds / factor - 1) < SAME_FACTOR for factor in SLOW_MOTION
        ):
            likely[name] = length, video.table.sound_seconds
    found = [
        f"{', '.join(names)}: filmed at {filmed:.4g} frames a second and stored at {rate:.4g}, so that everything takes "
        f"{filmed / rate:.3g} times as long. Store them at their true speed (ffmpeg -itsscale {rate / filmed:.6g} -i IN -c:v copy -an "
        f"OUT)"
        for (filmed, rate), names in stated.items()
    ]
    if likely:
        times = ", ".join(
            f"{name} ({length:.1f} s of images, {heard:.1f} s of sound)" for name, (length, heard) in likely.items()
        )
        found.append(
            f"may be slow motion, since the sound is several times shorter: {times}. Compare the speed with another camera's"
        )
    return found


def _jump(video: CompleteVideo) -> int | None:
    """Return the number of frames before a jump of a video's clock, or None without one."""
    jumps = np.flatnonzero(np.diff(video.times) > JUMP)
    if len(jumps):
        return int(jumps[0]) + 1
    return video.frames if isinstance(video, SegmentedVideo) and video.failure is not None else None


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


class GrowingVideos(_CameraVideos[GrowingCamera]):
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
        self._files = {}
        try:
            for name, file in files.items():
                self._files[name] = _camera(file, growth, sidecar.transfer)
        except BaseException:
            self.close()
            raise
        rates = [camera.fps for camera in self._files.values() if camera.fps]
        self.fps = sidecar.fps or round(float(np.median(rates)) if rates else 30.0, 3)
        self._starts = sidecar.starts
        self._speeds = sidecar.rates
        self.notes: list[str] = []

    @property
    def frames(self) -> int:
        """Number of time steps complete in all cameras."""
        return min(self.counts().values(), default=0)

    def counts(self) -> dict[str, int]:
        """Return the number of complete time steps by camera."""
        return {name: self._count(name, camera.last) for name, camera in self._files.items()}

    def waiting_for(self, name: str) -> Path:
        """Return the file of a camera's next frame."""
        return self._files[name].waiting_for

    def failure(self, name: str) -> str | None:
        """Return the reason why no more frames of a camera will be read; None while there is none."""
        camera = self._files[name]
        return None if camera.failure is None else f"{camera.path}: {camera.failure}"

    def update(self) -> None:
        """Check for new frames."""
        for camera in self._files.values():
            camera.update()

    def settle(self) -> None:
        """Count everything that exists, after the capture has ended."""
        for camera in self._files.values():
            camera.settle()

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Read time steps from `first` on of a camera into out [count, H, W, 3] uint8."""
        wanted = self._times(name, first, len(out))
        camera = self._files[name]
        camera.read_into(out, camera.numbers(wanted))

    def missing(self, first: int, count: int, name: str) -> np.ndarray:
        """Return [count] bool, the time steps for which a camera has no frame. The nearest frame stands in for it."""
        wanted = self._times(name, first, count)
        camera = self._files[name]
        return np.abs(camera.frame_times(camera.numbers(wanted)) - wanted) * self.fps > OUT_OF_STEP

    def tables(self) -> dict[Path, FrameTable]:
        """Return nothing, because more frames will follow."""
        return {}

    def tracks(self, first: int) -> dict[str, Track]:
        """Return by camera a written file that may have sound. `sound` follows it."""
        return {name: Track(camera.written, 0.0) for name, camera in self._files.items()}

    def sound(self, name: str, channels: int, first: int, seconds: float) -> Iterator[np.ndarray]:
        """Yield a camera's sound in blocks [n, channels] float32 at 48 kHz, from `seconds` after time step `first` on."""
        start = self._starts.get(name, 0.0) + self._speeds.get(name, 1.0) * (first / self.fps + seconds)
        yield from read_packets(self._files[name].sound(), channels, start)

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


def video_source(path: Path, files: dict[str, Path], sidecar: Sidecar, request: Request) -> Videos | GrowingVideos:
    """Return the source for a video per camera, or a folder of numbered videos per camera while they are being written."""
    files = {name: file for name, file in files.items() if name not in request.left_out}
    sidecar = sidecar.only({*sidecar.starts, *sidecar.rates} - request.left_out)
    if request.growth is None:
        return Videos(path, files, sidecar, request)
    return GrowingVideos(path, files, sidecar, request.growth)
