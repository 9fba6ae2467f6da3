"""Times at which the first keyframe is shown while it trains."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from splatreel.base.errors import ReconstructionError
from splatreel.codec.preview import write_preview
from splatreel.run.store import Store
from splatreel.scene.gaussians import Gaussians

FIRST_AFTER, EVERY = 4.0, 8.0
"""Seconds of training before the first preview, and from one preview to the next. Short trainings have none."""
MAX_SHARE = 0.05
"""Maximum share of the time that previews take."""


class KeyframePreview:
    """Writer of a preview every few seconds of training. Previews do not change the training."""

    def __init__(self, store: Store, clock: Callable[[], float] = time.monotonic) -> None:
        """Prepare the writer. The time counts from the first call of `show`.

        Args:
            store: Checkpoints of the run in OUT/work.
            clock: Time in seconds.
        """
        self._store = store
        self._clock = clock
        self._due: float | None = None
        self.written: Path | None = None
        """Folder of the last preview; None if none was due yet."""

    def show(self, gaussians: Callable[[], Gaussians]) -> None:
        """Write a preview if it is time for one. `gaussians` returns the points as they are now."""
        if self._due is None:
            self._due = self._clock() + FIRST_AFTER
        elif self._clock() >= self._due:
            self._write(gaussians())

    def finish(self, points: Gaussians) -> None:
        """Write the trained points, if the training took long enough for a preview."""
        if self.written is not None:
            self._write(points)

    def _write(self, points: Gaussians) -> None:
        begin = self._clock()
        try:
            header, limits = self._store.header()
        except ReconstructionError:  # a training without a reel
            self._due = float("inf")
            return
        self.written = write_preview(self._store.work.parent, header, limits, points)
        now = self._clock()
        self._due = now + max(EVERY, (now - begin) / MAX_SHARE)
