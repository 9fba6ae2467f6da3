"""Commands that get SIGTERM or Ctrl-C at random moments: each must end within seconds, and leave nothing half made.

python -m tests.signals 20 encode film
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from splatreel.capture.builtin_film import copy_film
from tests.kills import Command, commands

LIMIT = 5.0
"""Seconds that a command may take to end."""
CODES = {signal.SIGTERM: 143, signal.SIGINT: 130}


def start(arguments: list[str], log: Path) -> int:
    """Run a command in a process that begins with everything imported, as the command line does."""
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    code = 99
    try:
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.argv = ["splatreel", *arguments]
        from splatreel.cli.main import main

        code = main()
        sys.stdout.flush()
        threading._shutdown()  # pyright: ignore[reportAttributeAccessIssue]  # as the interpreter does: wait for threads
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def others(folder: Path, finished: Path) -> Iterator[Command]:
    """Commands that `tests.kills` does not have. finished: a run."""
    room = copy_film(folder / "room")
    yield Command("check", lambda out: ["capture", "check", str(room)])

    def videos(out: Path) -> list[str]:
        for file in room.glob("*.mp4"):
            shutil.copy(file, out)
        return ["capture", "calibrate", str(out)]

    yield Command("calibrate", videos)
    yield Command("demo", lambda out: ["demo", "--out", str(out / "demo"), "--quality", "draft", "--frames", "8"])
    reel = str(finished / "reel")
    yield Command("verify", lambda out: ["verify", reel])
    yield Command("serve", lambda out: ["serve", reel, "--port", "0"])
    yield Command("speed", lambda out: ["devices"])


def interrupt(command: Command, folder: Path, tries: int, rng: np.random.Generator, most: float) -> list[float]:
    """Send signals at random moments of a run. Returns seconds until the process had ended, for each one that was met.

    most: seconds into a run, at most.
    """
    whole, taken = most, []
    for number in range(tries):
        out = folder / f"{command.name} signal {number}"
        out.mkdir()
        which = signal.SIGTERM if number % 2 else signal.SIGINT
        child = start(command.arguments(out), log := folder / "log")
        time.sleep(rng.uniform(0.05, 0.9 * whole))
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            whole *= 0.7  # it was over by then
            continue
        began = time.monotonic()
        os.kill(child, which)
        status = os.waitpid(child, 0)[1]
        taken.append(time.monotonic() - began)
        code = os.waitstatus_to_exitcode(status)
        if code not in (CODES[which], 0, -which):
            raise AssertionError(f"{command.name}: code {code} after signal {which}\n{log.read_text(errors='replace')}")
        shutil.rmtree(out)
    return taken


def run(tries: int, names: list[str], limit: float = LIMIT, longest: float = 60.0) -> int:
    """Interrupt each of these commands so often, in its first `longest` seconds. Returns how many took longer than the limit."""
    late = 0

    with tempfile.TemporaryDirectory() as place:
        folder, rng = Path(place), np.random.default_rng(0)
        made: list[Command] = list(commands(folder))
        finished = folder / "sequence whole"
        finished.mkdir()
        child = start(made[0].arguments(finished), folder / "log")
        assert os.waitpid(child, 0)[1] == 0, (folder / "log").read_text()
        for command in [*made, *others(folder, finished)]:
            if names and command.name not in names:
                continue
            began = time.monotonic()
            probe = folder / f"{command.name} probe"
            probe.mkdir()
            child = start(command.arguments(probe), folder / "log")
            while not (ended := os.waitpid(child, os.WNOHANG)[0]) and time.monotonic() - began < longest:
                time.sleep(0.05)
            whole = min(time.monotonic() - began, longest)
            if not ended:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
            taken = interrupt(command, folder, tries, rng, whole)
            late += sum(seconds > limit for seconds in taken)
            slowest = max(taken, default=0.0)
            print(
                f"{command.name}: {len(taken)} signals in {whole:.1f} s, ended in {slowest:.2f} s at most", flush=True
            )
    return late


if __name__ == "__main__":
    sys.exit(run(int(sys.argv[1]), sys.argv[2:]) > 0)
