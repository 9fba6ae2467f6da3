"""Soundtrack of a live reel: encoded while it is recorded, and written with the groups."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, repeat
from pathlib import Path
from threading import Thread

import numpy as np

from splatreel.base.atomic import remove, write_bytes
from splatreel.base.errors import SplatreelError
from splatreel.base.progress import Progress
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.follower import Follower
from splatreel.capture.growing_video import choose_growing_track
from splatreel.capture.videos import GrowingVideos
from splatreel.codec.mp4 import RATE, initialization
from splatreel.codec.opus_sound import SEGMENT_SECONDS, TYPE, SoundEncoder
from splatreel.codec.presentation import Sound, SoundSegment
from splatreel.codec.writer import ReelWriter
from splatreel.run.output.sound_output import camera_position, parse_soundtrack_choice
from splatreel.run.store import load_checked, save_json

SELECTION_SECONDS = 10.0
"""Maximum seconds of sound by which a camera is selected."""
_INIT = "init.mp4"


class LiveSoundtrack:
    """Sound of one camera, in segments of two seconds. Use it as a context manager.

    A thread encodes the sound up to the frames that all cameras have, so that sound and video end together. OUT/work/sound
    keeps the segments as long as a group needs them. A resumed run takes the same camera, and continues after the last segment.

    Attributes:
        folder: Folder of the segments.
        camera: Name of the camera; None is silence.
    """

    def __init__(self, work: Path, follower: Follower, wanted: str, progress: Progress) -> None:
        """Select the camera.

        Args:
            work: Folder of the checkpoints.
            follower: The growing capture.
            wanted: auto, none, or the name of a camera.
            progress: Receives a note about the choice.
        """
        self.folder = work / "sound"
        self.follower = follower
        self.progress = progress
        capture = follower.capture
        source = capture.source if isinstance(capture, FileCapture) else None
        self._source = source if isinstance(source, GrowingVideos) else None
        self.camera, self._channels = self._choose(wanted) or (None, 1)
        self._thread = Thread(target=self._encode, name="sound", daemon=True)

    def __enter__(self) -> LiveSoundtrack:
        if self.camera is not None:
            write_bytes(self.folder / _INIT, initialization(self._channels))
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.follower.stop()
        if self.camera is not None:
            self._thread.join()

    def write(self, writer: ReelWriter) -> None:
        """Write the segments that exist and that the reel's groups need."""
        self._write_segments(writer, 2 * SEGMENT_SECONDS)

    def finish(self, writer: ReelWriter) -> None:
        """Write the remaining segments, after the capture has ended."""
        if self.camera is not None:
            self._thread.join()
            self._write_segments(writer, 0)

    def _write_segments(self, writer: ReelWriter, ahead: float) -> None:
        files = self._segments()
        if self.camera is None or not files or not writer.manifest.groups:
            return
        manifest = writer.manifest
        before = manifest.presentation.sound
        known = {segment.asset.uri: segment for segment in before.segments} if before is not None else {}
        needed = manifest.frames / manifest.fps + ahead
        segments = []
        for index, (file, seconds) in files.items():
            uri, start = f"sound/{index:04d}.m4s", float(index * SEGMENT_SECONDS)
            if start < needed:
                segment = known.get(uri)
                if segment is None or segment.seconds != seconds:  # the last segment may have grown
                    segment = SoundSegment(writer.write_asset(uri, file.read_bytes()), start, seconds)
                segments.append(segment)
        init = (
            before.init
            if before is not None
            else writer.write_asset(f"sound/{_INIT}", (self.folder / _INIT).read_bytes())
        )
        sound = Sound(
            TYPE, RATE, self._channels, init, tuple(segments), camera_position(self.follower.capture, self.camera)
        )
        sound = sound.trimmed_before(manifest.first_frame / manifest.fps)
        if sound != before:
            writer.present(replace(manifest.presentation, sound=sound))
        first = int(sound.segments[0].start) // SEGMENT_SECONDS
        for index, (file, _) in files.items():
            if index < first:
                remove(file)

    def _choose(self, wanted: str) -> tuple[str, int] | None:
        """Return the camera and its number of channels; None for silence."""
        file = self.folder / "choice.json"
        if file.exists():
            known = load_checked(file, parse_soundtrack_choice)
            return None if known is None else (known["camera"], known["channels"])
        capture = self.follower.capture
        tracks = {name: track.file for name, track in capture.tracks().items()}
        seconds = min(self.follower.frames / capture.fps, SELECTION_SECONDS)
        chosen = choose_growing_track(wanted, tracks, seconds, capture.path) if self._source is not None else None
        self.progress.note("Sound: none" if chosen is None else f"Sound: camera {chosen[0]}, recorded live")
        if chosen is None:
            save_json(file, None)
        else:
            name, channels = chosen
            position = camera_position(capture, name)
            save_json(file, {"camera": name, "channels": channels, "position": position})
        return chosen

    def _segments(self) -> dict[int, tuple[Path, float]]:
        """Return the segment files by number, each with its seconds. The last segment may be shorter."""
        found = {}
        for file in sorted(self.folder.glob("*.m4s")):
            index, _, samples = file.stem.partition("-")
            found[int(index)] = file, int(samples) / RATE
        return found

    def _encode(self) -> None:
        known = self._segments()
        full = SEGMENT_SECONDS * RATE
        first = max((index + (seconds * RATE == full) for index, (_, seconds) in known.items()), default=0)
        encoder = SoundEncoder(self._channels, first)
        for block in self._blocks(encoder):
            for data in encoder.add(block):
                self._save(first, data, full)
                first += 1
        if self.follower.total is not None:
            for data in encoder.finish():
                self._save(first, data, min(-(-encoder.samples // 960) * 960 - first * full, full))
                first += 1

    def _blocks(self, encoder: SoundEncoder) -> Iterator[np.ndarray]:
        """Yield the recorded samples, cut at the end of the capture. A block waits until all cameras have its frames."""
        fps, silence = self.follower.capture.fps, np.zeros((RATE // 50, self._channels), np.float32)
        for block in chain(self._recorded(encoder.begin / RATE), repeat(silence)):
            while len(block):
                frames = int(np.ceil((encoder.samples + len(block)) * fps / RATE))
                if self.follower.wait(frames):
                    yield block
                    break
                total = self.follower.total
                if total is None:
                    return  # stopped
                left = round(total / fps * RATE) - encoder.samples
                yield block[: max(left, 0)]
                return

    def _recorded(self, seconds: float) -> Iterator[np.ndarray]:
        assert self._source is not None
        assert self.camera is not None
        capture = self.follower.capture
        try:
            yield from self._source.sound(self.camera, self._channels, capture.first_frame, seconds)
        except SplatreelError as error:
            self.progress.note(f"{error} The reel continues without sound.")

    def _save(self, index: int, data: bytes, samples: int) -> None:
        """Save a segment. It replaces a shorter version that an earlier run saved."""
        for old in self.folder.glob(f"{index:06d}-*.m4s"):
            remove(old)
        write_bytes(self.folder / f"{index:06d}-{samples}.m4s", data)
