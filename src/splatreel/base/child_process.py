"""Long native calls in a child process, which can be killed at any moment.

Python handles signals between two of its own instructions. A C++ library that computes for minutes would therefore
delay Ctrl-C and SIGTERM. With a child process, the parent waits for messages and kills the child when it is
interrupted.
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

from splatreel.base.errors import SplatreelError
from splatreel.base.process import signals_held

_START = """
import pickle, sys
try:
    sys.path[:] = pickle.load(sys.stdin.buffer)
except (EOFError, pickle.UnpicklingError):
    sys.exit(1)  # the parent has ended
import splatreel.base.child_process
splatreel.base.child_process._serve()
"""
Send = Callable[[Any], None]
"""Sends a message from the child to its parent."""


class ChildEndedError(SplatreelError):
    """A child process that ended without a result.

    Attributes:
        how: The signal or the exit code, in words.
    """

    def __init__(self, how: str) -> None:
        super().__init__(f"The process that computed was ended {how}.")
        self.how = how


def run_in_child(function: Callable[..., Any], *arguments: Any, on_message: Callable[[Any], None]) -> Any:
    """Call a function in a child process and return its result.

    The child is killed when this call ends, also by an exception.

    Args:
        function: A function at module level. It takes a `Send`, then the arguments.
        *arguments: Picklable arguments.
        on_message: Called with each message that the function sends.

    Raises:
        ChildEndedError: The child was killed or crashed.
        BaseException: Any exception that the function raises.
    """
    command = [sys.executable, "-c", _START]
    # Signals to a whole process group reach the child, too. It inherits the mask and leaves them to its parent.
    with signals_held(signal.SIGINT, signal.SIGTERM):
        child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        with contextlib.suppress(BrokenPipeError):  # the child ended immediately; its exit code is reported below
            pickle.dump(sys.path, child.stdin)
            pickle.dump((function, arguments), child.stdin)
            child.stdin.flush()
        while True:
            try:
                kind, value = pickle.load(child.stdout)
            except (EOFError, pickle.UnpicklingError):
                raise ChildEndedError(_describe_exit(child.wait())) from None
            if kind == "message":
                on_message(value)
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
    """Run in the child: read the function from stdin, call it and send its result. End silently if the parent has ended."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries print to stdout, which carries the messages

    def send(kind: str, value: object) -> None:
        data = pickle.dumps((kind, value))
        try:
            out.write(data)
            out.flush()
        except BrokenPipeError:
            os._exit(1)

    try:
        function, arguments = pickle.load(sys.stdin.buffer)
    except (EOFError, pickle.UnpicklingError):
        os._exit(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        result = function(lambda value: send("message", value), *arguments)
    except BaseException as error:
        send("error", error)
    else:
        send("result", result)
    os._exit(0)


def _end_with_parent() -> None:
    """End the child when its parent has ended, which closes stdin."""
    os.read(0, 1)
    os._exit(1)


def _describe_exit(code: int) -> str:
    if code < 0:
        with contextlib.suppress(ValueError):
            return f"by {signal.Signals(-code).name}"
    return f"with exit code {code}"
