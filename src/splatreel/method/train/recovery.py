"""Recovery of training from NaN and infinity: return to the last good state, and continue at lower learning rates."""

from __future__ import annotations

import math
from typing import Protocol

from splatreel.base.errors import GaussiansError, GpuError, ReconstructionError
from splatreel.base.progress import Progress
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.method.deform.knot_adam import Restore

KEEP_EVERY = 250
"""Iterations between two saved states. Saving one takes a fraction of an iteration."""
SLOWDOWN = 0.5
"""Factor by which learning rates are multiplied at each recovery."""
ATTEMPTS = 4
"""Recoveries before training fails."""


class Training(Protocol):
    """A training whose state can be restored."""

    def snapshot(self) -> Restore:
        """Copy everything that training changes."""
        ...

    def check(self) -> None:
        """Raise a `GaussiansError` if a value is NaN or infinite."""
        ...


class Recovery:
    """Last good state of a training.

    A single failure may be chance: the pace returns to 1 once training has passed it. After a second failure the pace stays
    low.

    Attributes:
        pace: Factor for the learning rates.
    """

    def __init__(self) -> None:
        self.pace = 1.0
        self._attempts = 0
        self._failed = 0
        self._done = 0
        self._restore: Restore | None = None

    def save_state(self, done: int, training: Training) -> None:
        """Save the state after `done` iterations."""
        training.check()
        self._done = done
        self._restore = training.snapshot()

    def release_state(self) -> None:
        """Release the saved state. It refers to the training, and the training to this object, so both would stay in memory."""
        self._restore = None

    def check_iteration(self, done: int, loss: float, training: Training) -> None:
        """Raise a `GaussiansError` if an iteration gave NaN or infinity, and save the state if due."""
        if not math.isfinite(loss):
            raise GaussiansError(f"the training error is {loss}")
        if done >= self.next_save:
            self.save_state(done, training)
            if self._attempts == 1 and done > self._failed:
                self.pace = 1.0

    @property
    def next_save(self) -> int:
        """Number of iterations after which the state is saved again."""
        return self._done + KEEP_EVERY

    def leave_gpu(self, gpu: SharedGpu, error: GpuError, progress: Progress) -> int:
        """Return to the last good state, to continue on the CPU at the same rates. Return the number of iterations done in it.

        No training of this process uses the GPU that failed any more.
        """
        gpu.fail(error)
        if self._restore is not None:
            self._restore()
        reason = str(error).rstrip(".")
        progress.note(f"the GPU failed ({reason}): training continues on the CPU from iteration {self._done:,}")
        return self._done

    def restore(self, failed: int, error: GaussiansError, progress: Progress) -> int:
        """Restore the last good state and lower the learning rates. Return the number of iterations done in it.

        Too many recoveries raise a `ReconstructionError`. `failed` is the iteration after which NaN or infinity was
        found.
        """
        if self._attempts == ATTEMPTS:
            raise ReconstructionError(
                f"Training ends in NaN or infinity, even at {self.pace:g} times its learning rates: {error}. Look for a camera with "
                "a wrong image or pose (splatreel capture check), and leave it out. Finished groups are kept."
            ) from error
        self._attempts = self._attempts + 1
        self._failed = failed
        self.pace = SLOWDOWN**self._attempts
        progress.note(
            f"NaN or infinity at iteration {failed:,} ({str(error).rstrip('.')}): training continues from iteration "
            f"{self._done:,}, at {self.pace:g} times its learning rates"
        )
        if self._restore is not None:
            self._restore()
        return self._done
