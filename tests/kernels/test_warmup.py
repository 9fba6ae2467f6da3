"""Compiling kernels ahead of time."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from splatreel.base import jit
from splatreel.base.progress import Silent
from splatreel.kernels import warmup

SOURCE = Path(warmup.__file__).parent


class Notes(Silent):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def note(self, text: str) -> None:
        self.lines.append(text)


def test_warmup_lists_every_module_with_kernels() -> None:
    """A kernel missing from the list would compile at its first call, while the user waits."""
    with_kernels = {
        path.stem
        for path in SOURCE.glob("*.py")
        if " range_kernel(" in path.read_text(encoding="utf-8") or "@range_kernel(" in path.read_text(encoding="utf-8")
    }
    assert {f"kernels.{name}" for name in with_kernels} == set(warmup.MODULES)
    names = [kernel.name for kernel in warmup.kernels()]
    assert len(names) == len(set(names)) > 40


def test_warmup_compiles_in_another_process(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "NUMBA_CACHE_DIR": str(tmp_path)}
    program = (
        "from splatreel.base import jit; from splatreel.kernels import warmup; from splatreel.base.progress import Silent\n"
        "names = ['kernels.motion.normalize', 'kernels.binning.mark']\n"
        "chosen = [kernel for kernel in warmup.kernels() if kernel.name in names]\n"
        "warmup.kernels = lambda: chosen\n"
        "with warmup.background_warmup(Silent()) as running:\n"
        "    running.wait(lambda done: None)\n"
        "    for kernel in chosen: kernel.compile()\n"
        "print([sum(kernel.dispatcher.stats.cache_hits.values()) for kernel in chosen])\n"
        "with warmup.background_warmup(Silent()) as running: print(running)"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
    assert ran.stdout.splitlines() == ["[1, 1]", "None"], ran.stderr


def test_warmup_does_not_wait_for_dead_process(monkeypatch: pytest.MonkeyPatch) -> None:
    def dead(names: list[str]) -> subprocess.Popen[str]:
        return subprocess.Popen([sys.executable, "-c", "print('one', flush=True)"], stdout=subprocess.PIPE, text=True)

    monkeypatch.setattr(warmup, "_start", dead)
    running = warmup.BackgroundWarmup(Silent(), ["one", "two"], processes=1)
    running.wait_for("one")
    running.wait_for("two")
    running.stop()


def test_warmup_reports_progress_while_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    program = "import sys; print('one', flush=True); sys.stdin.readline()"

    def slow(names: list[str]) -> subprocess.Popen[str]:
        pipe = subprocess.PIPE
        return subprocess.Popen([sys.executable, "-c", program], stdin=pipe, stdout=pipe, text=True)

    monkeypatch.setattr(warmup, "_start", slow)
    notes = Notes()
    running = warmup.BackgroundWarmup(notes, ["one", "two"], processes=1)
    while "one" not in running._done:
        time.sleep(0.01)
    monkeypatch.setattr(warmup, "NOTE_AFTER", 0.0)
    waiting = threading.Thread(target=running.wait_for, args=("two",))
    waiting.start()
    while not notes.lines:
        time.sleep(0.01)
    running.stop()
    waiting.join(60)
    assert notes.lines[0] == "compiling kernels, once per machine (1 of 2)"


def test_kernels_do_not_wait_after_warmup() -> None:
    with warmup.background_warmup(Silent()):
        pass
    assert jit._warmup is None
