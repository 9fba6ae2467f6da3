"""Training whose numbers are no longer finite goes back to the last state in which they were, and goes on in smaller steps."""

from __future__ import annotations

import math
from typing import Protocol

from torch import Tensor

from splatreel.errors import GaussiansError, ReconstructionError
from splatreel.progress import Progress
from splatreel.recon.deform.adam import Restore

KEEP_EVERY = 250
"""Iterations between two states that are kept: copies of all points and moments take as long as a fraction of one iteration."""
SLOWER = 0.5
"""By what learning rates are multiplied each time."""
ATTEMPTS = 4
"""How often training goes back before it gives up."""


class Training(Protocol):
    """What has a state to go back to."""

    def snapshot(self) -> Restore:
        """Copies what training changes."""
        ...

    def check(self) -> None:
        """Raises `GaussiansError` if a value is NaN or infinite."""
        ...


class Recovery:
    """Keeps the last good state of a training. pace: what its learning rates are to be multiplied by.

    One failure may be chance, and once training is past it, it goes at its usual pace. After a second it stays slow.
    """

    def __init__(self) -> None:
        self.pace = 1.0
        self._attempts, self._failed = 0, 0
        self._done = 0
        self._restore: Restore | None = None

    def keep(self, done: int, training: Training) -> None:
        """Keep the state after so many iterations."""
        training.check()
        self._done, self._restore = done, training.snapshot()

    def drop(self) -> None:
        """Keep no state any longer. It refers to the training, and that to this: both would stay in memory for who knows how long."""
        self._restore = None

    def passed(self, done: int, loss: Tensor, training: Training) -> None:
        """After an iteration: keep the state where it is time for it. Raises `GaussiansError` if numbers are not finite.

        On a GPU only states that are kept are looked at, as to look is to wait for it.
        """
        due = done >= self._done + KEEP_EVERY
        if (due or not loss.is_cuda) and not math.isfinite(loss.item()):
            raise GaussiansError(f"the training error is {loss.item()}")
        if due:
            self.keep(done, training)
            if self._attempts == 1 and done > self._failed:
                self.pace = 1.0

    def go_back(self, failed: int, error: GaussiansError, progress: Progress) -> int:
        """Restore the last good state, and slow down. failed: the iteration after which numbers were found not to be finite.

        Returns how many iterations are done. Raises `ReconstructionError` after too many attempts.
        """
        if self._attempts == ATTEMPTS:
            raise ReconstructionError(
                f"Training ends in numbers that are not finite, also at {self.pace:g} times its learning rates: {error}. Look for a "
                "camera whose picture or pose is wrong (splatreel capture check), and leave it out; what was finished before is kept."
            ) from error
        self._attempts, self._failed = self._attempts + 1, failed
        self.pace = SLOWER**self._attempts
        progress.note(
            f"numbers were no longer finite at iteration {failed:,} ({str(error).rstrip('.')}): training goes on from iteration "
            f"{self._done:,}, at {self.pace:g} times its learning rates"
        )
        if self._restore is not None:
            self._restore()
        return self._done
