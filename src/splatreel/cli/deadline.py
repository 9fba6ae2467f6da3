"""Exit a few seconds after Ctrl-C or SIGTERM, even if native code or a worker thread is still busy.

Python's own handler runs between two instructions of the main thread, and exceptions close what is open. If this takes too long,
because a library computes or a thread is waited for, the process exits. All files that a command writes survive this: they are
moved into place when they are complete, and the next command removes the remains of a killed one.
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
"""Byte written after the last signal that counts. No signal has this number."""


@contextmanager
def deadline(say: Callable[[int], tuple[str, int]], lasting: bool) -> Iterator[None]:
    """Exit the process `GRACE` seconds after a signal that arrives in the block.

    Args:
        say: Takes the number of the signal. Returns the text for standard error, and the exit code.
        lasting: True if the process ends with this block. Threads that are still busy then must not delay it.
    """
    if os.name != "posix" or threading.current_thread() is not threading.main_thread():
        yield
        return
    read, write = os.pipe()
    os.set_blocking(write, False)
    watch = _Watch(read, say)
    try:
        watch.start()
    except RuntimeError:  # the system starts no more threads; the command may still work without
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
        os.write(write, _END)  # after the signals that arrived before
        if not lasting:
            watch.join()
            os.close(read)
            os.close(write)


class _Watch(threading.Thread):
    """Thread that waits for the bytes that the interpreter writes when a signal arrives, without a turn of the main thread."""

    def __init__(self, read: int, say: Callable[[int], tuple[str, int]]) -> None:
        """Remember the pipe and the message."""
        super().__init__(name="splatreel deadline", daemon=True)
        self.read = read
        self.say = say
        self.ended = threading.Event()

    def run(self) -> None:
        """Wait for a signal, then exit after the grace period. Leave signals to the main thread, which can hold them."""
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
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
