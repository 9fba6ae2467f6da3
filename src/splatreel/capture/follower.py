"""Following of a capture that is still being written: number of complete frames, and its end."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from pathlib import Path
from threading import Condition, Thread
from typing import Any

from splatreel.base.errors import CaptureError, SplatreelError
from splatreel.capture.base import Capture
from splatreel.capture.file_capture import FileCapture, GrowingSource
from splatreel.capture.growth import END, Growth
from splatreel.capture.opening import open_capture
from splatreel.capture.readers.colmap import is_colmap
from splatreel.capture.readers.easyvolcap import is_easyvolcap
from splatreel.capture.readers.neu3dv import POSES
from splatreel.capture.readers.panoptic import is_panoptic
from splatreel.capture.readers.technicolor import is_technicolor

STALL = 3.0
"""Seconds without frames, while other cameras continue, after which a camera is reported as stopped."""
RETRY = 0.5
"""Seconds between attempts to open a capture that has not started."""
REMEMBERED = 1 << 16
"""Number of remembered updates of the frame count."""

Notify = Callable[[str], None]


class Follower:
    """Context manager that follows a growing capture in a thread.

    Frames are counted from the first requested one. A frame exists when it and all earlier frames are complete in every
    camera.

    Args:
        capture: Growing capture.
        growth: Its state.
        notify: Called with sentences about cameras that stop or continue, and about the end of the capture.
    """

    def __init__(self, capture: Capture, growth: Growth, notify: Notify) -> None:
        if not isinstance(capture, FileCapture) or not isinstance(capture.source, GrowingSource):
            raise CaptureError(f"{capture.path}: is not being written. Leave out --follow.")
        self.capture = capture
        self.growth = growth
        self._notify = notify
        self._source: GrowingSource = capture.source
        self._changed = Condition()
        self._total: int | None = None
        self._failure: SplatreelError | None = None
        self._arrivals: deque[tuple[int, float]] = deque(maxlen=REMEMBERED)
        self._before = capture.frames
        self._seen = {name: (count, growth.clock()) for name, count in self._source.counts().items()}
        self._stopped: set[str] = set()
        self._failed: set[str] = set()
        self._thread = Thread(target=self._watch, name="follow", daemon=True)

    def __enter__(self) -> Follower:
        self.growth.grew()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._thread.join()

    @property
    def frames(self) -> int:
        """Number of frames so far."""
        return self.capture.frames

    @property
    def total(self) -> int | None:
        """Total number of frames, or None while the capture grows."""
        return self._total

    def wait(self, frames: int) -> bool:
        """Wait for a number of frames. Return False if the capture ends earlier. Errors of the capture are raised."""
        with self._changed:
            while self.frames < frames and self._total is None and self._failure is None and not self.growth.stopped:
                self._changed.wait(1.0)
            if self._failure is not None:
                raise self._failure
            return self.frames >= frames

    def seconds_since(self, frame: int) -> float | None:
        """Return the age of a frame in seconds; None if it existed when following began, or does not exist yet."""
        with self._changed:
            if not self._before <= frame < self.frames:
                return None
            at = bisect_left(self._arrivals, frame + 1, key=lambda arrival: arrival[0])
            return self.growth.clock() - self._arrivals[at][1] if at < len(self._arrivals) else None

    def stop(self) -> None:
        """Stop following."""
        self.growth.stop()
        with self._changed:
            self._changed.notify_all()

    def _watch(self) -> None:
        try:
            while not self.growth.stopped:
                why = self.growth.why  # read before looking, so that everything written before the end counts
                if why is not None:
                    self._source.settle()
                self._look()
                if why is not None or self._reached_limit():
                    self._finish(why)
                    return
                self.growth.pause()
        except SplatreelError as error:
            with self._changed:
                self._failure = error
                self._changed.notify_all()

    def _look(self) -> None:
        self._source.update()
        counts, now = self._source.counts(), self.growth.clock()
        for name, count in counts.items():
            if count > self._seen[name][0]:
                self._seen[name] = count, now
        with self._changed:
            before = self.frames
            self.capture.grow(min(counts.values()))
            if self.frames > before:
                self.growth.grew()
                self._arrivals.append((self.frames, now))
                self._changed.notify_all()
        self._report_stopped(counts, now)

    def _report_stopped(self, counts: dict[str, int], now: float) -> None:
        most, late = max(counts.values()), STALL * self.capture.fps
        for name, count in counts.items():
            if name in self._failed:
                continue
            if (failure := self._source.failure(name)) is not None:
                self._failed.add(name)
                self._notify(
                    f"Camera {name} ends after {count} frames: {failure}. The capture ends there. Record again into another folder."
                )
                continue
            silent = now - self._seen[name][1]
            if name in self._stopped and silent < STALL:
                self._stopped.discard(name)
                self._notify(f"Camera {name} continues from frame {count}.")
            elif name not in self._stopped and silent > STALL and most - count > late:
                self._stopped.add(name)
                self._notify(
                    f"Camera {name} has stopped: it has {count} frames, others {most}; nothing new in "
                    f"{self._source.waiting_for(name)} for {silent:.0f} s. The others wait for it."
                )

    def _reached_limit(self) -> bool:
        limit = self.capture.limit
        return limit is not None and self.capture.first_frame + self.frames >= limit

    def _finish(self, why: str | None) -> None:
        self._notify(f"{why or 'All frames that were asked for are there.'} The capture has {self.frames} frames.")
        with self._changed:
            self._total = self.frames
            self._changed.notify_all()


def open_growing(path: Path, growth: Growth, notify: Notify, **request: Any) -> Capture:
    """Open a growing capture. Wait if it has not started.

    Args:
        path: Folder of the capture.
        growth: Its state, with the maximum wait.
        notify: Called with the reason of a wait.
        **request: Arguments of `open_capture`.

    Raises:
        CaptureError: The capture cannot be followed, has no camera poses, or does not start.
    """
    _check_layout(path)
    reason: str | None = None
    while True:
        ended = growth.ended
        try:
            return open_capture(path, growth=growth, **request)
        except CaptureError as error:
            if ended:
                raise
            if reason is None:
                reason = str(error)
                notify(f"Waiting for the capture to begin, {growth.timeout:g} s at most. So far: {reason}")
            growth.pause(RETRY)


def _check_layout(path: Path) -> None:
    if is_panoptic(path) or is_technicolor(path):
        raise CaptureError(
            f"{path}: captures of this layout list their frames in advance and cannot be followed. Supported are a COLMAP model, a "
            f"Neu3DV or an EasyVolcap folder, with a video, a folder of images or a folder of numbered videos a camera."
        )
    if not (is_colmap(path) or is_easyvolcap(path) or (path / POSES).is_file()):
        raise CaptureError(
            f"{path}: has no camera poses, which following needs: record a few seconds "
            f"into another folder, run `splatreel capture calibrate` on them, and copy its sparse/ here. Then start recording, and "
            f"write an empty file {END} when it is over."
        )
