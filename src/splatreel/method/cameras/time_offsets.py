"""Time offsets of the cameras, learned with the motion that they show (beyond the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splatreel.method.deform.knot_adam import Restore
from splatreel.method.deform.protocol import Deformation, Slope

RATE = 0.03
"""Frames that an offset may change in one step at first. In the end it is a tenth of that."""
MOST_FRAMES = 1.5
"""Largest offset in frames. Tracks of a camera that is farther off are wrong in any case."""
LATER = 0.3
"""Change of an undetermined offset in the second half of the steps, as a share of its random walk over all steps, by the step sizes."""
CERTAIN = 4.0
"""Multiple of its uncertainty that an offset must have to be reported."""
FADES = (0.8, 0.95)
"""Shares of the mean slope and of the mean square that a step keeps."""


@dataclass(frozen=True)
class LearnedOffsets:
    """Frames [C] by which each camera is late, and the RMS change of each (`moved`) in the second half of training."""

    values: np.ndarray
    moved: float

    def uncertainty(self, ends: list[np.ndarray]) -> np.ndarray:
        """Return the uncertainty [C] of each offset in frames.

        An offset that the images do not determine goes on a random walk, another one in each group. The uncertainty is
        therefore estimated from the changes in the second half of training, and from group to group. `ends` are the
        offsets [C] at the end of each group so far, this group last.
        """
        moved = self.moved / LATER
        changes = np.square(np.diff(np.stack(ends), axis=0))
        if not len(changes):
            return np.full(len(self.values), moved)
        return np.maximum(np.sqrt(changes.mean(0)), max(moved, np.sqrt(changes.mean())))


class TimeOffsets:
    """Frames [C] by which each camera is late. Their mean stays zero, so that a camera that was never seen needs none.

    Phones that are started by the same clap are up to half a frame apart, and fast things are elsewhere in every view. An image is
    compared with the model at the time when it was taken. The gradient by this time is the gradient by the motion offsets, times
    their velocity. Steps are those of Adam.
    """

    def __init__(self, cameras: int, enabled: bool = True) -> None:
        self.enabled = enabled
        self.load(np.zeros(cameras))

    def load(self, values: np.ndarray) -> None:
        """Set the offsets [C]."""
        self.values = np.array(values, np.float64)
        self.restart()

    def restart(self) -> None:
        """Forget the optimizer's momentum, as a run that is continued from a checkpoint does."""
        self._slopes, self._squares, self._rounds = (np.zeros(len(self.values)) for _ in range(3))
        self._halfway = self.values.copy()
        self._pending: list[tuple[int, float]] = []

    def moment(self, frame: int, camera: int, frames: int) -> float:
        """Return the time when a camera took a frame, in frames of the group, clipped to the group."""
        return float(np.clip(frame + self.values[camera], 0, frames - 1)) if self.enabled else frame

    @property
    def independent(self) -> int:
        """Number of slopes, at least 1, until the next step of the offsets."""
        return len(self.values) - len(self._pending)

    def note(self, camera: int, slope: float, share: float) -> None:
        """Collect a slope. A step follows when there are as many slopes as cameras. `share` of the training is done."""
        self._pending.append((camera, slope))
        if len(self._pending) == len(self.values):
            cameras, slopes = zip(*self._pending, strict=True)
            self._step(np.array(cameras), np.array(slopes), RATE * 0.1**share)
            self._pending.clear()
            if share < 0.5:
                self._halfway = self.values.copy()

    def snapshot(self) -> Restore:
        """Return a function that restores the offsets, without the optimizer's momentum."""
        values, halfway = self.values.copy(), self._halfway.copy()

        def restore() -> None:
            self.load(values)
            self._halfway = halfway.copy()

        return restore

    def learned(self) -> LearnedOffsets:
        """Return the offsets that the training of a group found."""
        moved = float(np.sqrt(np.mean(np.square(self.values - self._halfway))))
        return LearnedOffsets(self.values.copy(), moved)

    def _step(self, cameras: np.ndarray, slopes: np.ndarray, rate: float) -> None:
        """Step the offsets of the cameras that were seen, by the mean of their slopes."""
        counts = np.bincount(cameras, minlength=len(self.values))
        seen, (fade, fade_square) = counts > 0, FADES
        mean = np.bincount(cameras, slopes, len(self.values))[seen] / counts[seen]
        self._rounds[seen] += 1
        self._slopes[seen] += (1 - fade) * (mean - self._slopes[seen])
        self._squares[seen] += (1 - fade_square) * (np.square(mean) - self._squares[seen])
        momentum = self._slopes[seen] / (1 - fade ** self._rounds[seen])
        square = self._squares[seen] / (1 - fade_square ** self._rounds[seen])
        self.values[seen] -= rate * momentum / (np.sqrt(square) + 1e-15)
        self.values = np.clip(self.values - self.values.mean(), -MOST_FRAMES, MOST_FRAMES)


def neighborhood(moment: float, frames: int) -> tuple[float, float]:
    """Return the times around a moment between which `slope` compares the motion, in frames of a group of `frames` frames."""
    return max(moment - 0.5, 0.0), min(moment + 0.5, frames - 1.0)


def slope(model: Deformation, means: np.ndarray, moment: float, frames: int, slopes: Sequence[Slope]) -> float:
    """Return the gradient of the loss by a camera's time, per frame. `slopes`: gradient at the moment, see `Deformation.gradient`."""
    before, after = neighborhood(moment, frames)
    return model.change(means, (before, after), slopes) / (after - before)
