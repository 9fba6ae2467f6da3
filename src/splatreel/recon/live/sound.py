"""The sound of a live reel: encoded as it is recorded, and published with the groups."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, repeat
from pathlib import Path
from threading import Thread

import numpy as np

from splatreel.capture.file_capture import FileCapture
from splatreel.capture.follower import Follower
from splatreel.capture.growing.growing_sound import choose_growing_track
from splatreel.capture.growing.growing_videos import GrowingVideos
from splatreel.codec.container import write_atomically
from splatreel.codec.fragments import RATE, initialization
from splatreel.codec.opus_sound import SEGMENT_SECONDS, TYPE, SoundEncoder
from splatreel.codec.presentation import Sound, SoundSegment
from splatreel.codec.writer import ReelWriter
from splatreel.errors import SplatreelError
from splatreel.progress import Progress
from splatreel.recon.encode.sound import place_of, sound_choice
from splatreel.recon.run import checkpoint

JUDGED = 10.0
"""Seconds, at most, by which a camera is chosen."""
_INIT = "init.mp4"


class LiveSound:
    """One camera's sound, in segments of two seconds, in OUT/work/sound until no group needs them. Use as a context manager.

    A thread encodes what is there in all cameras, no more: where the capture ends, so does its sound. A run that goes on takes the
    same camera, and begins where the segments end. camera: None is silent.
    """

    def __init__(self, work: Path, follower: Follower, wanted: str, progress: Progress) -> None:
        self.folder, self.follower, self.progress = work / "sound", follower, progress
        capture = follower.capture
        source = capture.source if isinstance(capture, FileCapture) else None
        self._source = source if isinstance(source, GrowingVideos) else None
        self.camera, self._channels = self._choose(wanted) or (None, 1)
        self._thread = Thread(target=self._encode, name="sound", daemon=True)

    def __enter__(self) -> LiveSound:
        if self.camera is not None:
            write_atomically(self.folder / _INIT, initialization(self._channels))
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.follower.stop()
        if self.camera is not None:
            self._thread.join()

    def publish(self, writer: ReelWriter) -> None:
        """Give a reel what there is by now, and of its first groups on."""
        self._publish(writer, 2 * SEGMENT_SECONDS)

    def finish(self, writer: ReelWriter) -> None:
        """Once the capture has ended: the rest."""
        if self.camera is not None:
            self._thread.join()
            self._publish(writer, 0)

    def _publish(self, writer: ReelWriter, ahead: float) -> None:
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
                if segment is None or segment.seconds != seconds:  # the last one may have grown
                    segment = SoundSegment(writer.write_asset(uri, file.read_bytes()), start, seconds)
                segments.append(segment)
        init = (
            before.init
            if before is not None
            else writer.write_asset(f"sound/{_INIT}", (self.folder / _INIT).read_bytes())
        )
        sound = Sound(TYPE, RATE, self._channels, init, tuple(segments), place_of(self.follower.capture, self.camera))
        sound = sound.trimmed_before(manifest.first_frame / manifest.fps)
        if sound != before:
            writer.present(replace(manifest.presentation, sound=sound))
        first = int(sound.segments[0].start) // SEGMENT_SECONDS
        for index, (file, _) in files.items():
            if index < first:
                file.unlink(missing_ok=True)

    def _choose(self, wanted: str) -> tuple[str, int] | None:
        """The camera and its channels."""
        file = self.folder / "choice.json"
        if file.exists():
            known = checkpoint.load_checked(file, sound_choice)
            return None if known is None else (known["camera"], known["channels"])
        capture = self.follower.capture
        tracks = {name: track.file for name, track in capture.tracks().items()}
        seconds = min(self.follower.frames / capture.fps, JUDGED)
        chosen = choose_growing_track(wanted, tracks, seconds, capture.path) if self._source is not None else None
        self.progress.note("Sound: none" if chosen is None else f"Sound: camera {chosen[0]}, as it is recorded")
        if chosen is None:
            checkpoint.save_json(file, None)
        else:
            name, channels = chosen
            position = place_of(capture, name)
            checkpoint.save_json(file, {"camera": name, "channels": channels, "position": position})
        return chosen

    def _segments(self) -> dict[int, tuple[Path, float]]:
        """By number, each with its seconds: the last one of all may be shorter."""
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
        """What is recorded, cut where the capture ends; nothing is given before all cameras are as far."""
        fps, silence = self.follower.capture.fps, np.zeros((RATE // 50, self._channels), np.float32)
        for block in chain(self._recorded(encoder.begin / RATE), repeat(silence)):
            while len(block):
                frames = int(np.ceil((encoder.samples + len(block)) * fps / RATE))
                if self.follower.wait(frames):
                    yield block
                    break
                total = self.follower.total
                if total is None:
                    return  # nobody wants more
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
            self.progress.note(f"{error} The reel goes on in silence.")

    def _save(self, index: int, data: bytes, samples: int) -> None:
        """A shorter one of a run that went on is replaced."""
        for old in self.folder.glob(f"{index:06d}-*.m4s"):
            old.unlink()
        write_atomically(self.folder / f"{index:06d}-{samples}.m4s", data)
