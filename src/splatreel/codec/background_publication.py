"""Publishing a reel while it is being written, without holding up who writes it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from itertools import chain, repeat

from splatreel.codec.publication import Publication, Published
from splatreel.errors import SplatreelError

PAUSES = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)
"""Seconds after failures in a row; the last one is waited again and again."""
LAST_TRIES = 6
"""Failures in a row after which it is given up, once the reel is whole."""


class BackgroundPublication:
    """A thread that updates a publication after each `changed`, and tries again as long as it fails. It looks at once whether the
    place can be reached.

    tell: hears of failures and of their end; it is called from the thread. failure: why the last update failed; None if it did not.
    """

    def __init__(
        self, publication: Publication, tell: Callable[[str], None], pauses: tuple[float, ...] = PAUSES
    ) -> None:
        self._publication, self._tell, self._pauses = publication, tell, pauses
        self._condition = threading.Condition()
        self._changed, self._ending, self._stopped = True, False, False
        self._published: Published | None = None
        self.failure: SplatreelError | None = None
        self._bug: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="splatreel-publication", daemon=True)
        self._thread.start()

    def changed(self) -> None:
        """There is more to publish; returns at once."""
        with self._condition:
            self._changed = True
            self._condition.notify()

    def finish(self) -> Published | None:
        """Wait until all of the reel is there; None where there is no reel. Raises the `SplatreelError` for which it was given up."""
        with self._condition:
            self._changed = self._ending = True
            self._condition.notify()
        while self._thread.is_alive():
            self._thread.join(0.5)  # a signal gets through in between
        for error in (self._bug, self.failure):
            if error is not None:
                raise error
        return self._published

    def stop(self) -> None:
        """Give up at once what is not there; what is being sent may still arrive."""
        with self._condition:
            self._stopped = True
            self._condition.notify()

    def _run(self) -> None:
        try:
            while self._wait():
                self._update()
        except BaseException as error:  # a bug: whoever waits for the end hears of it
            self._bug = error

    def _wait(self) -> bool:
        """For something to do; False once all is done."""
        with self._condition:
            self._condition.wait_for(lambda: self._changed or self._ending or self._stopped)
            go_on = self._changed and not self._stopped
            self._changed = False
            return go_on

    def _update(self) -> None:
        """Until it works, is stopped, or is given up after the end."""
        sent, since_end, failed, pauses = self._publication.sent, 0, False, self._endless_pauses()
        while not self._stopped:
            ending, self._changed = self._ending, False
            try:
                self._published, self.failure = self._publication.update(), None
                break
            except SplatreelError as error:
                self.failure = error
                if not failed:
                    self._tell(f"{error} It is tried again.")
                if self._publication.sent > sent:  # it goes on, if slowly
                    sent, since_end, pauses = self._publication.sent, 0, self._endless_pauses()
                failed, since_end = True, since_end + ending
                if since_end >= LAST_TRIES:
                    return
            self._pause(next(pauses), ending)
        if failed and self.failure is None:
            self._tell(f"{self._publication.folder.address('')}: it works again, all that there is so far is there.")

    def _pause(self, seconds: float, ending: bool) -> None:
        """Shorter where it is stopped, or where the end begins only now."""
        with self._condition:
            self._condition.wait_for(lambda: self._stopped or self._ending != ending, timeout=seconds)

    def _endless_pauses(self) -> Iterator[float]:
        return chain(self._pauses, repeat(self._pauses[-1]))
