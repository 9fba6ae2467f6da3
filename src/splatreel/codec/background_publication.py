"""Publishing of a reel in a background thread while the reel is being written."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from itertools import chain, repeat

from splatreel.base.errors import SplatreelError
from splatreel.codec.publication import Publication, Published

PAUSES = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)
"""Seconds to wait after each consecutive failure. The last pause repeats."""
LAST_TRIES = 6
"""Consecutive failures after which publishing is given up, once the reel is complete."""


class BackgroundPublication:
    """Thread that updates a publication after each call of `changed`, and retries after failures.

    The thread starts with an update, which checks that the folder can be reached.

    Args:
        publication: Publication to update.
        report: Called from the thread when failures start and when they end.
        pauses: Seconds to wait after consecutive failures.

    Attributes:
        failure: Error of the last update, or None if it succeeded.
    """

    def __init__(
        self, publication: Publication, report: Callable[[str], None], pauses: tuple[float, ...] = PAUSES
    ) -> None:
        self._publication = publication
        self._report = report
        self._pauses = pauses
        self._condition = threading.Condition()
        self._changed = True
        self._ending = False
        self._stopped = False
        self._published: Published | None = None
        self.failure: SplatreelError | None = None
        self._bug: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="splatreel-publication", daemon=True)
        self._thread.start()

    def changed(self) -> None:
        """Request an update and return immediately."""
        with self._condition:
            self._changed = True
            self._condition.notify()

    def finish(self) -> Published | None:
        """Wait until the whole reel is published.

        Returns:
            The result of the last update, or None if there is no reel.

        Raises:
            SplatreelError: Publishing was given up.
        """
        with self._condition:
            self._changed = self._ending = True
            self._condition.notify()
        while self._thread.is_alive():
            self._thread.join(0.5)  # wake up regularly to handle signals
        for error in (self._bug, self.failure):
            if error is not None:
                raise error
        return self._published

    def stop(self) -> None:
        """Stop publishing immediately. A transfer in progress may still complete."""
        with self._condition:
            self._stopped = True
            self._condition.notify()

    def _run(self) -> None:
        try:
            while self._wait():
                self._update()
        except BaseException as error:  # a bug; `finish` raises it
            self._bug = error

    def _wait(self) -> bool:
        """Wait for a change. Return False when the thread should end."""
        with self._condition:
            self._condition.wait_for(lambda: self._changed or self._ending or self._stopped)
            go_on = self._changed and not self._stopped
            self._changed = False
            return go_on

    def _update(self) -> None:
        """Update until success, until stopped, or until too many failures after the end of the reel."""
        sent, since_end, failed, pauses = self._publication.sent, 0, False, self._endless_pauses()
        while not self._stopped:
            ending, self._changed = self._ending, False
            try:
                self._published = self._publication.update()
                self.failure = None
                break
            except SplatreelError as error:
                self.failure = error
                if not failed:
                    self._report(f"{error} Retrying.")
                if self._publication.sent > sent:  # some files arrived, so start counting again
                    sent, since_end, pauses = self._publication.sent, 0, self._endless_pauses()
                failed, since_end = True, since_end + ending
                if since_end >= LAST_TRIES:
                    return
            self._pause(next(pauses), ending)
        if failed and self.failure is None:
            self._report(f"{self._publication.folder.address('')}: is reachable again; everything so far is published.")

    def _pause(self, seconds: float, ending: bool) -> None:
        """Wait after a failure. The wait ends early if the thread is stopped or the reel ends."""
        with self._condition:
            self._condition.wait_for(lambda: self._stopped or self._ending != ending, timeout=seconds)

    def _endless_pauses(self) -> Iterator[float]:
        return chain(self._pauses, repeat(self._pauses[-1]))
