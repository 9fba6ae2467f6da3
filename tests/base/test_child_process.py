"""A child process computes, reports progress and never outlives the call."""

import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import pytest

from splatreel.base.child_process import _START, ChildEndedError, run_in_child
from splatreel.base.errors import CaptureError


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


def stop_by_group(send: Callable[[Any], None]) -> str:
    """Get the signal that a batch system sends to a whole process group."""
    os.kill(os.getpid(), signal.SIGTERM)
    send(os.getpid())
    return "finished"


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_child_leaves_signals_of_the_process_group_to_its_parent() -> None:
    heard: list[int] = []
    assert run_in_child(stop_by_group, on_message=heard.append) == "finished"
    assert len(heard) == 1


@pytest.mark.parametrize(
    "sent", [b"", pickle.dumps(sys.path)[:-9], pickle.dumps(sys.path)], ids=["nothing", "part", "path"]
)
def test_child_of_a_killed_parent_ends_silently(sent: bytes) -> None:
    ended = subprocess.run([sys.executable, "-c", _START], input=sent, capture_output=True, timeout=120)
    assert (ended.returncode, ended.stderr) == (1, b"")


def chatter(send: Callable[[Any], None]) -> None:
    for _ in range(100_000):
        send("x" * 1000)


def test_child_whose_parent_stops_reading_ends_silently() -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", _START], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert child.stdin is not None
    assert child.stdout is not None
    assert child.stderr is not None
    child.stdin.write(pickle.dumps(sys.path) + pickle.dumps((chatter, ())))
    child.stdin.flush()
    assert pickle.load(child.stdout)[0] == "message"
    child.stdout.close()
    assert child.wait(timeout=120) == 1
    assert child.stderr.read() == b""
    child.stdin.close()
    child.stderr.close()
