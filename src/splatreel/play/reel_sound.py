"""Sound of a reel: decoded samples, and the sound track of a film."""

from __future__ import annotations

from collections import OrderedDict

import av
import numpy as np
from av.container import OutputContainer

from splatreel.base.errors import ReelError
from splatreel.codec.mp4 import RATE
from splatreel.codec.opus_sound import PREROLL, TYPE, check_sound_size, decode_sound
from splatreel.codec.presentation import Asset, Sound
from splatreel.codec.reader import ReelReader

_CACHED_SEGMENTS = 4
_BITS_A_SECOND = 96_000
"""Bit rate of a film's sound per channel."""


class ReelSound:
    """Decoder of a reel's sound.

    `rate` is in samples per second. `position` is the source in world units, or None for sound from everywhere.
    """

    def __init__(self, reel: ReelReader, sound: Sound) -> None:
        """Prepare to read the segments of `sound`. Nothing is read yet."""
        self._reel = reel
        self._sound = sound
        self._files: OrderedDict[str, bytes] = OrderedDict()
        self.rate = sound.rate
        self.channels = sound.channels
        self.position = sound.position

    @property
    def duration(self) -> float:
        """Duration in seconds. It exceeds that of the reel by up to a packet."""
        last = self._sound.segments[-1]
        return last.start + last.seconds

    def samples(self, start: float, seconds: float) -> np.ndarray:
        """Decode a range of time. The samples do not depend on where the range starts.

        Args:
            start: Start in seconds of the reel.
            seconds: Duration.

        Returns:
            [round(seconds * rate), channels] float32, silent where the reel has no sound.

        Raises:
            ReelError: A file is damaged, or the sound is not Opus.
        """
        first, count = round(start * self.rate), max(round(seconds * self.rate), 0)
        out = np.zeros((count, self.channels), np.float32)
        if self._sound.type != TYPE or self.rate != RATE:
            raise ReelError(f"{self._reel.name}: its sound is {self._sound.type!r}; only {TYPE!r} is decoded.")
        end = start + seconds
        needed = [s for s in self._sound.segments if s.start < end and s.start + s.seconds > start - PREROLL]
        if not needed:
            return out
        for segment in needed:
            check_sound_size(segment)
        most = round((sum(s.seconds for s in needed) + 1) * self.rate)
        try:
            init, *segments = (self._read(asset) for asset in (self._sound.init, *(s.asset for s in needed)))
            for time, part in decode_sound(init, segments, self.channels):
                at, most = time - first, most - len(part)
                if most < 0:
                    raise ReelError("The sound is longer than the manifest says.")
                part = part[max(-at, 0) : max(count - at, 0)]
                out[max(at, 0) : max(at, 0) + len(part)] = part
        except ReelError as error:
            raise ReelError(f"{needed[0].asset.uri}: {error}") from error
        return out

    def _read(self, asset: Asset) -> bytes:
        data = self._files.pop(asset.sha256, None) or self._reel.read_file(asset)
        self._files[asset.sha256] = data
        if len(self._files) > _CACHED_SEGMENTS:
            self._files.popitem(last=False)
        return data


class FilmSound:
    """AAC track of a film, written along with its frames."""

    def __init__(self, container: OutputContainer, sound: ReelSound, start: float) -> None:
        """Add the track to a container. start: time of the reel at which the film begins, in seconds."""
        self._container = container
        self._sound = sound
        self._start = start
        self._done = 0
        self._layout = "mono" if sound.channels == 1 else "stereo"
        self._stream = container.add_stream("aac", rate=sound.rate, layout=self._layout)
        self._stream.bit_rate = _BITS_A_SECOND * sound.channels

    def write(self, end: float) -> None:
        """Write the samples up to `end`, in seconds of the film."""
        count = round(end * self._sound.rate) - self._done
        samples = self._sound.samples(self._start + self._done / self._sound.rate, count / self._sound.rate)
        frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(samples.T), "fltp", self._layout)
        frame.sample_rate, frame.pts = self._sound.rate, self._done
        self._container.mux(self._stream.encode(frame))
        self._done += count

    def finish(self) -> None:
        """Write the samples that the encoder still holds."""
        self._container.mux(self._stream.encode())
