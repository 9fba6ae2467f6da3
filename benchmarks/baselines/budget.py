"""Training time of a baseline, shared among the frames of a video."""

from __future__ import annotations

from dataclasses import dataclass

RECENT = 5
"""Number of finished frames whose speed predicts that of the next one. Points that are added make iterations slower."""


@dataclass(frozen=True)
class Spent:
    """Cost of one frame.

    Attributes:
        seconds: Seconds of training.
        iterations: Iterations of training.
    """

    seconds: float
    iterations: int


class Budget:
    """Seconds that all remaining frames share evenly, as numbers of iterations.

    Args:
        seconds: Seconds of training for all frames.
        frames: Number of frames.
        pace: Expected seconds of an iteration, for the first frame.
        spent: Cost of the frames that are finished.
    """

    def __init__(self, seconds: float, frames: int, pace: float, spent: list[Spent]) -> None:
        self.seconds = seconds
        self.frames = frames
        self.pace = pace
        self.spent = list(spent)

    @property
    def left(self) -> float:
        """Seconds that are left; 0 if more are spent than there were."""
        return max(self.seconds - sum(frame.seconds for frame in self.spent), 0.0)

    def iterations(self) -> int:
        """Return the number of iterations of the next frame, at least one."""
        recent = self.spent[-RECENT:]
        pace = sum(f.seconds for f in recent) / sum(f.iterations for f in recent) if recent else self.pace
        share = self.left / max(self.frames - len(self.spent), 1)
        return max(int(share / max(pace, 1e-9)), 1)

    def spend(self, seconds: float, iterations: int) -> None:
        """Add the cost of a frame."""
        self.spent.append(Spent(seconds, iterations))
