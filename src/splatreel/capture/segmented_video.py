"""Video of a camera in numbered files of some seconds each, such as `cam00/000001.mp4`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.files import LOCAL, Files, list_folder, open_media
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.growing_video import JUMP, Packets, sound_errors
from splatreel.capture.growth import Growth
from splatreel.capture.video import VIDEO_SUFFIXES, VideoFile

NUMBERED = re.compile(r"(.*?)(\d+)")
CHAPTER = re.compile("(?:GOPR|G[HXLP]([0-9]{2}))([0-9]{4})", re.IGNORECASE)
"""Name of a chapter of a GoPro recording: the number of the chapter, then that of the recording."""
SELF_CONTAINED = (".mp4", ".m4v", ".mov")
"""Files that become readable when they are complete. Other files are complete when the next one exists."""
OPEN = 2
"""Number of files kept open."""


@dataclass(frozen=True)
class Numbered:
    """Consecutively numbered files of a folder.

    Attributes:
        folder: Folder of the files.
        prefix: Name before the number.
        digits: Minimum digits of the number.
        suffix: Name after the number.
        start: Number of the first file.
        chosen: Names of the files of a complete recording, where these are known; further files are not searched.
    """

    folder: Path
    prefix: str
    digits: int
    suffix: str
    start: int
    chosen: tuple[str, ...] = ()

    def file(self, index: int) -> Path:
        """Return the file at an index from the first."""
        if index < len(self.chosen):
            return self.folder / self.chosen[index]
        return self.folder / f"{self.prefix}{self.start + index:0{self.digits}d}{self.suffix}"


def numbered(files: list[Path]) -> Numbered | None:
    """Return the naming of the files of a folder, or None without files.

    Raises:
        CaptureError: A name has no number, or GoPro's chapters are not those of one recording.
    """
    if not files:
        return None
    if chapters := _chapters(files):
        return chapters
    found: list[tuple[int, re.Match[str], Path]] = []
    for file in files:
        match = NUMBERED.fullmatch(file.stem)
        if match is None:
            raise CaptureError(f"{file}: the names of files that are followed end in numbers, one after the other.")
        found.append((int(match[2]), match, file))
    start, match, file = min(found, key=lambda entry: entry[0])
    return Numbered(file.parent, match[1], len(match[2]), file.suffix, start)


def _chapters(files: list[Path]) -> Numbered | None:
    """Return the chapters of a GoPro recording in order: GX010042, GX020042, ..., or GOPR0042, GP010042, ...; None for others."""
    matches = [CHAPTER.fullmatch(file.stem) for file in files]
    if not all(matches):
        return None
    order = sorted(
        (int(match[1] or 0), match[2], file.name) for match, file in zip(matches, files, strict=True) if match
    )
    recordings = sorted({recording for _, recording, _ in order})
    folder, names = files[0].parent, tuple(name for _, _, name in order)
    if len(recordings) > 1:
        raise CaptureError(
            f"{folder}: holds chapters of {len(recordings)} GoPro recordings ({', '.join(recordings)}). Leave those of one recording."
        )
    if [chapter for chapter, _, _ in order] != list(range(order[0][0], order[0][0] + len(order))):
        raise CaptureError(f"{folder}: lacks a chapter between {names[0]} and {names[-1]}. Copy it there.")
    return Numbered(folder, "", 0, "", len(names), names)


def segment_files(folder: Path) -> list[Path]:
    """Return the videos in a folder by their numbers."""
    return [file for file in list_folder(folder) if file.suffix.lower() in VIDEO_SUFFIXES and file.is_file()]


@dataclass(frozen=True)
class Segment:
    """File of a segmented video.

    Attributes:
        first: Number of its first frame.
        start: Seconds from the first frame of the video to its first frame.
        times: Times of its frames after its first.
        begins: Time of its first frame in the file.
    """

    file: Path
    first: int
    start: float
    times: np.ndarray
    begins: float


class SegmentedVideo:
    """Frames of all complete files in order.

    A file is complete when the next one exists, when the capture has ended, or when it is a readable MP4 file. Times
    may continue from file to file or restart in each.

    Attributes:
        is_complete: True if the files are chapters of a camera, which were not written to be followed.
    """

    def __init__(
        self,
        folder: Path,
        names: Numbered,
        growth: Growth,
        files: Files = LOCAL,
        tables: Mapping[Path, FrameTable] | None = None,
        transfer: str | None = None,
    ) -> None:
        self.path = folder
        self._names = names
        self._growth = growth
        self._transfer = transfer
        self.is_complete = bool(names.chosen)
        self._files = files
        self._known = tables or {}
        self.tables: dict[Path, FrameTable] = {}
        self.segments: list[Segment] = []
        self.failure: str | None = None
        self._open: dict[Path, VideoFile] = {}
        self._origin = 0.0
        while not self.segments and not growth.ended:
            self.update()
            if not self.segments:
                growth.pause()
        self.update()
        if not self.segments:
            raise CaptureError(f"{self.waiting_for}: is not complete. Record again or leave the camera out.")
        first = self._video(self.segments[0].file)
        self.width = first.width
        self.height = first.height
        self.fps = first.fps
        self.color = first.color

    def update(self) -> None:
        """Check for completed files."""
        while self.failure is None and (video := self._complete(len(self.segments))) is not None:
            if not self.segments:
                self._origin = video.start
            says, follows = video.start - self._origin, self._end()
            start = says if says > follows - 0.5 / max(video.fps, 1e-3) else follows
            if np.diff(np.append(follows, start + video.times)).max() > JUMP:
                self.failure = f"its time jumps in {video.path.name}, {follows:.1f} s after its first frame"
                return
            first = sum((len(self.segments[-1].times), self.segments[-1].first)) if self.segments else 0
            self.tables[video.path] = video.table
            self.segments.append(Segment(video.path, first, start, video.times, video.start))

    def settle(self) -> None:
        """Count the readable part of the last file, after the capture has ended."""
        self.update()

    @property
    def frames(self) -> int:
        """Number of complete frames."""
        return self.segments[-1].first + len(self.segments[-1].times) if self.segments else 0

    @property
    def times(self) -> np.ndarray:
        """Times of the frames in seconds after the first one, [frames] float64."""
        return np.concatenate([segment.start + segment.times for segment in self.segments] or [np.zeros(0)])

    @property
    def waiting_for(self) -> Path:
        """File of the next frame."""
        return self._names.file(len(self.segments))

    @property
    def last(self) -> float | None:
        """Seconds from the first frame to the last complete one, or None."""
        if not self.segments:
            return None
        return self.segments[-1].start + float(self.segments[-1].times[-1])

    def numbers(self, wanted: np.ndarray) -> np.ndarray:
        """Return the number of the frame nearest to each time, in seconds after the first frame."""
        starts = np.array([segment.start for segment in self.segments])
        low = max(int(np.searchsorted(starts, wanted.min(), "right")) - 2, 0)
        high = int(np.searchsorted(starts, wanted.max(), "right")) + 1
        near = self.segments[low:high]
        times = np.concatenate([segment.start + segment.times for segment in near])
        return near[0].first + np.searchsorted((times[1:] + times[:-1]) / 2, wanted)

    def frame_times(self, numbers: np.ndarray) -> np.ndarray:
        """Return the times of frames in seconds after the first frame."""
        return self.times[numbers]

    def read_into(self, out: np.ndarray, numbers: np.ndarray) -> None:
        """Decode frames with ascending numbers into out [count, H, W, 3] uint8 sRGB, resized by area to H x W."""
        firsts = np.array([segment.first for segment in self.segments])
        which = np.searchsorted(firsts, numbers, "right") - 1
        for index in np.unique(which):
            mine = np.flatnonzero(which == index)
            segment = self.segments[index]
            part = np.empty((len(mine), *out.shape[1:]), np.uint8)
            video = self._video(segment.file)
            if (video.width, video.height) != (self.width, self.height):
                raise CaptureError(
                    f"{segment.file}: is {video.width}x{video.height}, {self.written.name} is {self.width}x{self.height}. Convert "
                    f"all videos of a camera to one size."
                )
            video.read_into(part, numbers[mine] - segment.first)
            out[mine] = part

    @property
    def written(self) -> Path:
        """File that can be read already."""
        return self.segments[0].file

    def sound(self) -> Packets:
        """Yield the packets of the sound track, file by file as they are completed."""
        index = 0
        while True:
            ended = self._growth.ended  # read before looking, so that all completed files count
            if index < len(self.segments):
                yield from self._sound_of(self.segments[index])
                index += 1
            elif ended:
                return
            else:
                self._growth.pause()

    def _sound_of(self, segment: Segment) -> Packets:
        with sound_errors(segment.file), open_media(self._files, segment.file) as container:
            for packet in container.demux(container.streams.audio[0]):
                if packet.size:
                    yield segment.begins - segment.start, packet

    def close(self) -> None:
        """Close open files."""
        for video in self._open.values():
            video.close()
        self._open.clear()

    def _end(self) -> float:
        if not self.segments:
            return 0.0
        last = self.segments[-1]
        step = last.times[-1] / (len(last.times) - 1) if len(last.times) > 1 else 0.0
        return last.start + float(last.times[-1] + step)

    def _complete(self, index: int) -> VideoFile | None:
        file = self._names.file(index)
        if not file.exists():
            return None
        over = self._names.file(index + 1).exists() or self._growth.ended
        if not over and file.suffix.lower() not in SELF_CONTAINED:
            return None
        try:
            video = self._video(file)
        except CaptureError:
            if self._growth.ended:
                return None  # the last file was truncated
            if over:
                raise
            return None
        return video if video.frames else None

    def _video(self, file: Path) -> VideoFile:
        video = self._open.pop(file, None)
        if video is None:
            video = VideoFile(file, self._files, self.tables.get(file) or self._known.get(file), self._transfer)
        self._open[file] = video  # most recently used last
        while len(self._open) > OPEN:
            oldest = next(iter(self._open))
            self._open.pop(oldest).close()
        return video
