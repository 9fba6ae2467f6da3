"""Clock of the Python viewer."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Clock:
    """Playback time, which advances while playing and stops or loops at the end."""

    duration: float
    """End of the reel, in seconds."""
    playing: bool = True
    loop: bool = True
    rate: float = 1.0
    """Seconds of the reel per second."""
    time: float = 0.0
    """Present time, in seconds of the reel."""
    start: float = 0.0
    """Start of the reel, in seconds."""

    def __post_init__(self) -> None:
        self.time = max(self.time, self.start)

    def advance(self, seconds: float) -> None:
        """Advance by `seconds` of real time."""
        if not self.playing or self.duration <= self.start:
            return
        self.time += seconds * self.rate
        if self.time >= self.duration:
            self.playing = self.loop
            length = self.duration - self.start
            self.time = self.start + (self.time - self.start) % length if self.loop else self.duration

    def seek(self, time: float) -> None:
        """Go to a time, clamped to the reel."""
        self.time = min(max(time, self.start), self.duration)

    def toggle(self) -> None:
        """Play or pause. At the end, play from the start."""
        if not self.playing and self.time >= self.duration:
            self.time = self.start
        self.playing = not self.playing
