"""Runs long native calls in a process of their own, which can be killed at any moment.

Python handles a signal between two of its own instructions. A library that computes for minutes in C++ delays Ctrl-C and SIGTERM for
as long. In a child process it delays nobody: the parent waits for messages, and kills the child when it is interrupted.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

from splatreel.errors import SplatreelError
from splatreel.process import interrupts_held

_START = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); import splatreel.child_process as c; c._serve()"
)
Send = Callable[[Any], None]
"""Sends a message from the child to its parent."""


class ChildEndedError(SplatreelError):
    """The child process ended without a result. how: the signal or the exit code, in words."""

    def __init__(self, how: str) -> None:
        super().__init__(f"The process that computed was ended {how}.")
        self.how = how


def run_in_child(function: Callable[..., Any], *arguments: Any, hear: Callable[[Any], None]) -> Any:
    """Call a function in a child process and return its result. Whatever ends this call also ends the child.

    Args:
        function: A module's function. It takes a `Send`, and then the arguments.
        arguments: Anything that can be pickled.
        hear: Called with each message that the function sends.

    Raises:
        ChildEndedError: The child was killed or crashed.
        BaseException: Whatever the function raises.
    """
    command = [sys.executable, "-c", _START]
    with interrupts_held():  # the child inherits the mask: Ctrl-C in a terminal goes to all processes there
        child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        with contextlib.suppress(BrokenPipeError):  # then it ended at once, and its exit code tells how
            pickle.dump(sys.path, child.stdin)
            pickle.dump((function, arguments), child.stdin)
            child.stdin.flush()
        while True:
            try:
                kind, value = pickle.load(child.stdout)
            except (EOFError, pickle.UnpicklingError):
                raise ChildEndedError(_how(child.wait())) from None
            if kind == "message":
                hear(value)
            elif kind == "result":
                return value
            else:
                raise value
    finally:
        child.kill()
        child.wait()
        with contextlib.suppress(BrokenPipeError):
            child.stdin.close()
        child.stdout.close()


def _serve() -> None:
    """Run the function that comes in by stdin, in the child."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not get among the messages

    def send(kind: str, value: object) -> None:
        pickle.dump((kind, value), out)
        out.flush()

    try:
        function, arguments = pickle.load(sys.stdin.buffer)
        threading.Thread(target=_end_with_parent, daemon=True).start()
        result = function(lambda value: send("message", value), *arguments)
    except BaseException as error:
        send("error", error)
    else:
        send("result", result)
    os._exit(0)


def _end_with_parent() -> None:
    """End when the parent is gone, which closes stdin."""
    os.read(0, 1)
    os._exit(1)


def _how(code: int) -> str:
    if code < 0:
        with contextlib.suppress(ValueError):
            return f"by {signal.Signals(-code).name}"
    return f"with exit code {code}"
