"""When each camera takes its pictures, learned with the motion that they show (beyond the paper)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from splatreel.recon.deform.adam import Restore
from splatreel.recon.deform.protocol import Deformation

RATE = 0.03
"""Frames that a delay may go in one step at first; a tenth of it in the end."""
MOST_FRAMES = 1.5
"""Frames that a camera may be late or early: of what is farther off, tracks are wrong already."""
LATER = 0.3
"""Of how far chance carries a delay that the pictures do not tell, the share of the second half of the steps, by their sizes."""
CERTAIN = 4.0
"""Times its uncertainty that a delay must be for anybody to hear of it."""
FADES = (0.8, 0.95)
"""Share that a step keeps of the mean slope and of its mean square before."""


@dataclass(frozen=True)
class LearnedOffsets:
    """values: [C] frames by which each camera is late. moved: RMS frames that they still went in the second half of training."""

    values: np.ndarray
    moved: float

    def uncertainty(self, ends: list[np.ndarray]) -> np.ndarray:
        """[C] frames that each offset may be off: what the pictures do not tell goes where chance carries it, and no two times alike.

        By how far offsets still went in the second half of a group's training, and from group to group. ends: [C] offsets at the end
        of each group so far, this one's last.
        """
        moved = self.moved / LATER
        changes = np.square(np.diff(np.stack(ends), axis=0))
        if not len(changes):
            return np.full(len(self.values), moved)
        return np.maximum(np.sqrt(changes.mean(0)), max(moved, np.sqrt(changes.mean())))


class TimeOffsets:
    """Frames by which each camera is late, [C]; their mean is held at zero, so that a camera never seen needs none.

    Phones that begin with the same clap are apart by up to half a frame, and what is fast is elsewhere in every view. A picture is
    compared with the model at the moment that it was taken; how the loss changes with the moment is how it changes with the
    offsets, times their velocity. Steps are Adam's.
    """

    def __init__(self, cameras: int, enabled: bool = True) -> None:
        self.enabled = enabled
        self.load(np.zeros(cameras))

    def load(self, values: np.ndarray) -> None:
        self.values = np.array(values, np.float64)
        self.restart()

    def restart(self) -> None:
        """Forget the optimizer's momentum: a run continued from a checkpoint goes on as one that was never stopped."""
        self._slopes, self._squares, self._rounds = (np.zeros(len(self.values)) for _ in range(3))
        self._halfway = self.values.copy()
        self._pending: list[tuple[int, Tensor]] = []

    def moment(self, frame: int, camera: int, frames: int) -> float:
        """When a camera took its picture of a frame, in frames of the group, which ends where those of the group do."""
        return float(np.clip(frame + self.values[camera], 0, frames - 1)) if self.enabled else frame

    def note(self, camera: int, slope: Tensor, share: float) -> None:
        """slope: of the loss by a camera's moment; it is read when there are as many as cameras, which then take a step.

        share: 0..1, how much of training is over.
        """
        self._pending.append((camera, slope))
        if len(self._pending) == len(self.values):
            cameras, slopes = zip(*self._pending, strict=True)
            self._step(np.array(cameras), torch.stack(slopes).double().cpu().numpy(), RATE * 0.1**share)
            self._pending.clear()
            if share < 0.5:
                self._halfway = self.values.copy()

    def snapshot(self) -> Restore:
        """The offsets; going back to them forgets the optimizer's momentum."""
        values, halfway = self.values.copy(), self._halfway.copy()

        def restore() -> None:
            self.load(values)
            self._halfway = halfway.copy()

        return restore

    def learned(self) -> LearnedOffsets:
        """What a group's training found."""
        moved = float(np.sqrt(np.mean(np.square(self.values - self._halfway))))
        return LearnedOffsets(self.values.copy(), moved)

    def _step(self, cameras: np.ndarray, slopes: np.ndarray, rate: float) -> None:
        """Of the cameras that came up, by the mean of their slopes."""
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


@torch.no_grad()
def slope(model: Deformation, means: Tensor, moment: float, frames: int, d_dx: Tensor, d_dq: Tensor) -> Tensor:
    """[] what the loss gains by a frame of delay. frames: more than one.

    d_dx: [N, 3], d_dq: [N, 4]: its gradients to the offsets of means [N, 3] at a moment.
    """
    before, after = max(moment - 0.5, 0.0), min(moment + 0.5, frames - 1.0)
    (dx, dq), (dx_after, dq_after) = (model.offsets(means, at) for at in (before, after))
    return (((dx_after - dx) * d_dx).sum() + ((dq_after - dq) * d_dq).sum()) / (after - before)
