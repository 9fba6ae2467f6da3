"""Compiling all kernels ahead of time, in other processes.

Numba compiles a kernel when it is first called, which takes a minute for all of them. A warmup starts when a command does, so that most
kernels are in the cache on disk when they are needed.
"""

from __future__ import annotations

import contextlib
import importlib
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence

from splatreel.base import jit
from splatreel.base.progress import Progress

MODULES = (
    "kernels.binning",
    "kernels.project",
    "kernels.harmonics",
    "kernels.blending",
    "kernels.rasterize",
    "kernels.photometric",
    "kernels.deform",
    "kernels.adam",
    "kernels.rigid",
    "kernels.sceneflow",
    "kernels.motion",
    "kernels.photo_consistency",
    "kernels.hashgrid",
)
"""Modules with kernels, in the order in which a reconstruction needs them."""
NOTE_AFTER, NOTE_EVERY = 1.0, 5.0
"""Seconds of waiting for a kernel before the first message to the user, and between two messages."""
COMPILING = "compiling kernels, once per machine"


def kernels() -> list[jit.Kernel]:
    """Return all kernels, in the order in which a reconstruction needs them."""
    modules = [importlib.import_module(f"splatreel.{name}") for name in MODULES]
    values = [(module, value) for module in modules for value in vars(module).values()]
    return [value for module, value in values if isinstance(value, jit.Kernel) and value.module == module.__name__]


def compile_kernels(progress: Progress, processes: int = 1) -> int:
    """Compile all kernels that are not in the cache, in other processes. Return their number."""
    todo = [kernel for kernel in kernels() if kernel.needs_warmup()]
    progress.stage(COMPILING, len(todo))
    with background_warmup(progress, processes) as warmup:
        if warmup is not None:
            warmup.wait(lambda done: progress.update(done))
    progress.update(len(todo))
    return len(todo)


class BackgroundWarmup:
    """Child processes that compile kernels while this process does other work.

    Each process compiles every n-th kernel and prints the name of a kernel when it is in the cache.
    """

    def __init__(self, progress: Progress, names: Sequence[str], processes: int) -> None:
        """Start the processes for kernels, named in the order of their use. `progress` receives a message about waiting."""
        self._progress = progress
        self._names = names
        self._done: set[str] = set()
        self._changed = threading.Condition()
        self._noted = -NOTE_EVERY
        self._processes = [_start(names[place::processes]) for place in range(min(processes, len(names)))]
        self._alive = len(self._processes)
        for process in self._processes:
            threading.Thread(target=self._listen, args=(process,), daemon=True).start()

    def wait_for(self, kernel: str) -> None:
        """Wait until a kernel is in the cache, or until no process is left that could compile it."""
        since = time.monotonic()
        with self._changed:
            while kernel in self._names and kernel not in self._done and self._alive:
                self._changed.wait(0.1)
                now = time.monotonic()
                if now - since > NOTE_AFTER and now - self._noted > NOTE_EVERY:
                    self._noted = now
                    self._progress.note(f"{COMPILING} ({len(self._done)} of {len(self._names)})")

    def wait(self, report: Callable[[int], None]) -> None:
        """Wait until all kernels are in the cache. report: called with the number of kernels that are."""
        with self._changed:
            while self._alive:
                self._changed.wait(0.5)
                report(len(self._done))

    def stop(self) -> None:
        """Kill the processes."""
        for process in self._processes:
            process.kill()
            process.wait()

    def _listen(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            with self._changed:
                self._done.add(line.strip())
                self._changed.notify_all()
        with self._changed:
            self._alive -= 1
            self._changed.notify_all()


@contextlib.contextmanager
def background_warmup(progress: Progress, processes: int = 1) -> Iterator[BackgroundWarmup | None]:
    """Compile kernels in the background inside a `with` block; yield None if all are in the cache.

    A kernel that is called before it is compiled waits, and `progress` receives a message.
    """
    names = [kernel.name for kernel in kernels() if kernel.needs_warmup()]
    if not names:
        yield None
        return
    warmup = BackgroundWarmup(progress, names, processes)
    jit.use_warmup(warmup)
    try:
        yield warmup
    finally:
        jit.use_warmup(None)
        warmup.stop()


def _start(names: Sequence[str]) -> subprocess.Popen[str]:
    program = "import sys; from splatreel.kernels.warmup import compile_named; compile_named(sys.argv[1:])"
    command = [sys.executable, "-c", program, *names]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdin=quiet, stdout=subprocess.PIPE, stderr=quiet, text=True)


def compile_named(names: Sequence[str]) -> None:
    """Compile kernels in this process, and print the name of each when it is in the cache."""
    by_name = {kernel.name: kernel for kernel in kernels()}
    for name in names:
        by_name[name].compile()
        print(name, flush=True)
