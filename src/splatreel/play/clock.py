"""A player's clock: it runs while playing, stops or loops at the end, and can be set."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Clock:
    """duration, time: seconds of the reel. rate: seconds of the reel a second."""

    duration: float
    playing: bool = True
    loop: bool = True
    rate: float = 1.0
    time: float = 0.0

    def advance(self, seconds: float) -> None:
        """Let some seconds pass."""
        if not self.playing or self.duration <= 0:
            return
        self.time += seconds * self.rate
        if self.time >= self.duration:
            self.playing = self.loop
            self.time = self.time % self.duration if self.loop else self.duration

    def seek(self, time: float) -> None:
        """Go to a time, kept within the reel."""
        self.time = min(max(time, 0.0), self.duration)

    def toggle(self) -> None:
        """Play or pause; at the end, play from the beginning."""
        if not self.playing and self.time >= self.duration:
            self.time = 0.0
        self.playing = not self.playing
