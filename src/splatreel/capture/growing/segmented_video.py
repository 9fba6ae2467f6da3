"""A camera whose video is written in numbered files of some seconds each, such as `cam00/000001.mp4`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.capture.files import LOCAL, Files, open_media
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.growing.growing_sound import Packets, guard
from splatreel.capture.growing.growth import Growth
from splatreel.capture.video import VIDEO_SUFFIXES, VideoFile
from splatreel.errors import CaptureError

NUMBERED = re.compile(r"(.*?)(\d+)")
SELF_CONTAINED = (".mp4", ".m4v", ".mov")
"""Files that can be read as soon as they are complete, and not before; of others only the next one tells that they are."""
OPEN = 2
"""Files that are held open."""


@dataclass(frozen=True)
class Numbered:
    """Files of a folder that count one by one. start: the number of the first one."""

    folder: Path
    prefix: str
    digits: int
    suffix: str
    start: int

    def file(self, index: int) -> Path:
        """The file that many after the first."""
        return self.folder / f"{self.prefix}{self.start + index:0{self.digits}d}{self.suffix}"


def numbered(files: list[Path]) -> Numbered | None:
    """How files of one folder are called; None where there is none. Raises `CaptureError` for one whose name is not numbered."""
    found: list[tuple[int, re.Match[str], Path]] = []
    for file in files:
        match = NUMBERED.fullmatch(file.stem)
        if match is None:
            raise CaptureError(f"{file}: the names of files that are followed end in numbers, one after the other.")
        found.append((int(match[2]), match, file))
    if not found:
        return None
    start, match, file = min(found)[0], *min(found)[1:]
    return Numbered(file.parent, match[1], len(match[2]), file.suffix, start)


def segment_files(folder: Path) -> list[Path]:
    """Return the videos that lie in a folder."""
    return [file for file in folder.iterdir() if file.suffix.lower() in VIDEO_SUFFIXES and file.is_file()]


@dataclass(frozen=True)
class Segment:
    """first: the number of its first frame. start: seconds from the first frame of all to its own; begins: what the file says of it."""

    file: Path
    first: int
    start: float
    times: np.ndarray
    begins: float


class SegmentedVideo:
    """The frames of all files that are complete, one after the other.

    A file is complete when the next one is there, or the capture has ended, or it is an MP4 file that can be read. Times in the files
    may go on from one to the next, or begin anew in each.
    """

    def __init__(
        self,
        folder: Path,
        names: Numbered,
        growth: Growth,
        files: Files = LOCAL,
        tables: Mapping[Path, FrameTable] | None = None,
    ) -> None:
        self.path, self._names, self._growth = folder, names, growth
        self._files, self._known = files, tables or {}
        self.tables: dict[Path, FrameTable] = {}
        self.segments: list[Segment] = []
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
        self.width, self.height, self.fps = first.width, first.height, first.fps

    def update(self) -> None:
        """Look for files that were completed."""
        while (video := self._complete(len(self.segments))) is not None:
            if not self.segments:
                self._origin = video.start
            says, follows = video.start - self._origin, self._end()
            start = says if says > follows - 0.5 / max(video.fps, 1e-3) else follows
            first = sum((len(self.segments[-1].times), self.segments[-1].first)) if self.segments else 0
            self.tables[video.path] = video.table
            self.segments.append(Segment(video.path, first, start, video.times, video.start))

    def settle(self) -> None:
        """Once the capture has ended: the last file counts as far as it is whole."""
        self.update()

    @property
    def frames(self) -> int:
        """Number of frames that are whole."""
        return self.segments[-1].first + len(self.segments[-1].times) if self.segments else 0

    @property
    def times(self) -> np.ndarray:
        """[frames] float64, seconds after the first frame."""
        return np.concatenate([segment.start + segment.times for segment in self.segments] or [np.zeros(0)])

    @property
    def waiting_for(self) -> Path:
        """The file in which the next frame will be."""
        return self._names.file(len(self.segments))

    @property
    def last(self) -> float | None:
        """Seconds from the first frame to the last one that is whole; None where none is."""
        if not self.segments:
            return None
        return self.segments[-1].start + float(self.segments[-1].times[-1])

    def numbers(self, wanted: np.ndarray) -> np.ndarray:
        """Of each time, in seconds after the first frame, the number of the frame nearest to it."""
        starts = np.array([segment.start for segment in self.segments])
        low = max(int(np.searchsorted(starts, wanted.min(), "right")) - 2, 0)
        high = int(np.searchsorted(starts, wanted.max(), "right")) + 1
        near = self.segments[low:high]
        times = np.concatenate([segment.start + segment.times for segment in near])
        return near[0].first + np.searchsorted((times[1:] + times[:-1]) / 2, wanted)

    def read_into(self, out: np.ndarray, numbers: np.ndarray) -> None:
        """Decode the frames of these numbers, in rising order, into out [count, H, W, 3] uint8 sRGB, resized by area to H x W."""
        firsts = np.array([segment.first for segment in self.segments])
        which = np.searchsorted(firsts, numbers, "right") - 1
        for index in np.unique(which):
            mine = np.flatnonzero(which == index)
            segment = self.segments[index]
            part = np.empty((len(mine), *out.shape[1:]), np.uint8)
            self._video(segment.file).read_into(part, numbers[mine] - segment.first)
            out[mine] = part

    @property
    def written(self) -> Path:
        """A file that can be read by now, to see what it holds."""
        return self.segments[0].file

    def sound(self) -> Packets:
        """The packets of its sound track, file after file, as they are completed."""
        index = 0
        while True:
            ended = self._growth.ended  # asked first: files that were completed before count
            if index < len(self.segments):
                yield from self._sound_of(self.segments[index])
                index += 1
            elif ended:
                return
            else:
                self._growth.pause()

    def _sound_of(self, segment: Segment) -> Packets:
        with guard(segment.file), open_media(self._files, segment.file) as container:
            for packet in container.demux(container.streams.audio[0]):
                if packet.size:
                    yield segment.begins - segment.start, packet

    def close(self) -> None:
        for video in self._open.values():
            video.close()
        self._open.clear()

    def _end(self) -> float:
        """Where the next frame belongs if none is missing."""
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
                return None  # its last file was cut off
            if over:
                raise
            return None
        return video if video.frames else None

    def _video(self, file: Path) -> VideoFile:
        video = self._open.pop(file, None)
        if video is None:
            video = VideoFile(file, self._files, self.tables.get(file) or self._known.get(file))
        self._open[file] = video  # the one used last is the last
        while len(self._open) > OPEN:
            oldest = next(iter(self._open))
            self._open.pop(oldest).close()
        return video
