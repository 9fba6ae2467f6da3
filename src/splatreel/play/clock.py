"""A player's clock: it runs while playing, stops or loops at the end, and can be set."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Clock:
    """start, duration, time: where the reel begins and ends, and where it is, seconds. rate: seconds of the reel a second."""

    duration: float
    playing: bool = True
    loop: bool = True
    rate: float = 1.0
    time: float = 0.0
    start: float = 0.0

    def __post_init__(self) -> None:
        self.time = max(self.time, self.start)

    def advance(self, seconds: float) -> None:
        """Let some seconds pass."""
        if not self.playing or self.duration <= self.start:
            return
        self.time += seconds * self.rate
        if self.time >= self.duration:
            self.playing = self.loop
            length = self.duration - self.start
            self.time = self.start + (self.time - self.start) % length if self.loop else self.duration

    def seek(self, time: float) -> None:
        """Go to a time, kept within the reel."""
        self.time = min(max(time, self.start), self.duration)

    def toggle(self) -> None:
        """Play or pause; at the end, play from the beginning."""
        if not self.playing and self.time >= self.duration:
            self.time = self.start
        self.playing = not self.playing
