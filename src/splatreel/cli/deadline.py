"""Ends the command a few seconds after Ctrl-C or SIGTERM, whatever native code or a worker thread is doing then.

Python's own handler runs between two instructions of the main thread, and what is open is closed by exceptions. Where that takes too
long, since a library computes or a thread is waited for, the process exits. Everything that a command writes stands that: files are
moved into place whole, and what a killed command left is removed by the next one.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

GRACE = 3.0
"""Seconds that a command gets to end by itself."""
_END = b"\0"
"""Written after the last signal that counts; no signal has this number."""


@contextmanager
def deadline(say: Callable[[int], tuple[str, int]], lasting: bool) -> Iterator[None]:
    """Exit the process `GRACE` seconds after a signal that arrives inside.

    Args:
        say: Takes the number of the signal. Returns the last words for standard error, and the exit code.
        lasting: The process ends with this block: its threads that are still at work then must not hold it up.
    """
    if os.name != "posix" or threading.current_thread() is not threading.main_thread():
        yield
        return
    read, write = os.pipe()
    os.set_blocking(write, False)
    watch = _Watch(read, say)
    try:
        watch.start()
    except RuntimeError:  # the system lets no thread start: what needs none goes on
        os.close(read)
        os.close(write)
        yield
        return
    before = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(before, warn_on_full_buffer=False)
        if not lasting:
            watch.ended.set()
        os.write(write, _END)  # behind the signals that arrived before
        if not lasting:
            watch.join()
            os.close(read)
            os.close(write)


class _Watch(threading.Thread):
    """Waits for the bytes that the interpreter writes when a signal arrives, which needs no turn of the main thread."""

    def __init__(self, read: int, say: Callable[[int], tuple[str, int]]) -> None:
        super().__init__(name="splatreel deadline", daemon=True)
        self.read, self.say, self.ended = read, say, threading.Event()

    def run(self) -> None:
        while True:
            for number in os.read(self.read, 64):
                if number in (signal.SIGINT, signal.SIGTERM):
                    self._exit_later(number)
                    return
                if number == _END[0]:
                    return

    def _exit_later(self, number: int) -> None:
        if self.ended.wait(GRACE):
            return
        text, code = self.say(number)
        os.write(2, f"{text}\n".encode())
        os._exit(code)
