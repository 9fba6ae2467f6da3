"""A child process computes, reports progress and never outlives the call."""

import os
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

from splatreel.child_process import ChildEndedError, run_in_child
from splatreel.errors import CaptureError


def double(send: Callable[[Any], None], number: int) -> int:
    print("noise of a library", flush=True)
    os.write(1, b"noise of a native library\n")
    send("half")
    send(os.getpid())
    return 2 * number


def fail(send: Callable[[Any], None]) -> None:
    raise CaptureError("scene: is none")


def die(send: Callable[[Any], None]) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def never_end(send: Callable[[Any], None]) -> None:
    """Block signals, like native code that never returns to Python."""
    signal.pthread_sigmask(signal.SIG_BLOCK, set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP})
    send(os.getpid())
    while True:
        time.sleep(60)


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_child_returns_result_and_messages() -> None:
    heard: list[Any] = []
    assert run_in_child(double, 21, on_message=heard.append) == 42
    assert heard[0] == "half"
    assert heard[1] != os.getpid()
    assert not is_alive(heard[1])


def test_child_error_is_raised_in_the_parent() -> None:
    with pytest.raises(CaptureError, match="scene: is none"):
        run_in_child(fail, on_message=print)


def test_killed_child_is_reported() -> None:
    with pytest.raises(ChildEndedError, match="by SIGKILL"):
        run_in_child(die, on_message=print)


def test_interrupt_kills_the_child() -> None:
    """The child ignores signals."""
    heard: list[int] = []

    def interrupt(pid: int) -> None:
        heard.append(pid)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_in_child(never_end, on_message=interrupt)
    assert not is_alive(heard[0])
