"""The real command, stopped by real signals, and continued by the same command."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from splatreel.cli import main as cli
from splatreel.cli.failure import Terminated, termination
from splatreel.cli.main import main
from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader
from tests.capture import folders
from tests.method.captures import WallCapture

SHORT = """
import sys
from splatreel import config
from tests.method.small import small

config.preset = lambda quality: small({"group.length": 3, "group.iterations_per_frame": 4, "keyframe.refine_iterations": 10})

from splatreel.cli.main import main
sys.exit(main())
"""
"""The command with a preset of few iterations."""


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    source = WallCapture(5)
    folder = tmp_path / "capture"
    folder.mkdir()
    for camera in source.cameras:
        folders.write_video(folder / f"{camera.name}.mp4", list(source.read(0, 5, [camera.name])[:, 0]))
    np.save(folder / "poses_bounds.npy", folders.llff(source.cameras))
    return folder


def start(capture: Path, out: Path, title: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", SHORT, "reconstruct", str(capture), "--out", str(out), "--title", title]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)


@pytest.mark.slow
@pytest.mark.kill
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_signals_stop_the_command_and_the_same_command_continues(capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    stops = [
        ("group 2/2: training the keyframe", signal.SIGINT, 130, 1),
        ("group 2/2: training the motion", signal.SIGKILL, -signal.SIGKILL, 1),
    ]
    for line, number, code, published in stops:
        process = start(capture, out, "A wall")
        assert process.stderr is not None
        seen = next((text for text in process.stderr if text.startswith(line)), None)
        assert seen is not None, line
        process.send_signal(number)
        errors = process.communicate(timeout=600)[1]
        assert process.returncode == code, errors
        assert "Traceback" not in errors
        if number != signal.SIGKILL:
            assert "continue with the same command:\n  splatreel reconstruct" in errors
        assert verify_reel(out / "reel").groups == published
    process = start(capture, out, "Another wall")  # which is no other run
    output, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors
    assert "at its first frame" not in errors  # both were kept
    assert f"splatreel serve {out / 'reel'}" in output
    assert verify_reel(out / "reel").groups == 2
    said = ReelReader(out / "reel").manifest.presentation
    assert said.title == "Another wall"
    assert said.poster is not None
    assert said.thumbnails is not None
    assert said.limits is not None
    assert [file for file in out.rglob("*") if file.suffix == ".tmp"] == []


class Busy:
    """A command during which SIGTERM arrives."""

    def __init__(self) -> None:
        self.closed = False

    def cli(self, **_: object) -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(60)
        finally:
            self.closed = True


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_sigterm_ends_like_ctrl_c(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    command, before = Busy(), signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(cli, "build", lambda _: command)
    assert main(["reconstruct", "capture"]) == 143
    assert command.closed
    assert capsys.readouterr().err.endswith("continue with the same command:\n  splatreel reconstruct capture\n")
    assert signal.getsignal(signal.SIGTERM) is before


def test_signal_waits_until_a_callback_of_llvm_is_done(tmp_path: Path) -> None:
    """There exceptions are dropped, and LLVM crashes."""
    done: list[int] = []
    scope = {"os": os, "signal": signal, "time": time, "done": done}
    source = "def callback():\n    os.kill(os.getpid(), signal.SIGTERM)\n    time.sleep(0.2)\n    done.append(1)\n"
    exec(compile(source, str(tmp_path / "llvmlite" / "executionengine.py"), "exec"), scope)

    def load() -> None:
        with termination():
            scope["callback"]()
            time.sleep(60)

    with pytest.raises(Terminated):
        load()
    assert done


STUCK = """
import sys, threading, time
from splatreel.cli import main as cli

class Stuck:
    def cli(self, **_):
        {stuck}

cli.build = lambda _: Stuck()
sys.exit(cli.main())
"""
DEAF = """
        try:
            print("ready", flush=True)
            time.sleep(600)
        finally:
            time.sleep(600)
"""
"""Closing what is open takes too long, as it would while a library computes."""
BUSY = """
        threading.Thread(target=time.sleep, args=(600,)).start()
        print("ready", flush=True)
        time.sleep(600)
"""
"""A thread works on, which Python waits for."""


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
@pytest.mark.parametrize("stuck", [DEAF, BUSY])
def test_busy_command_exits_after_the_grace_period(stuck: str, number: int, code: int) -> None:
    command = [sys.executable, "-c", STUCK.format(stuck=stuck), "encode", "run"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    errors = process.communicate(timeout=60)[1]
    assert process.returncode == code
    assert errors.endswith("continue with the same command:\n  splatreel encode run\n")
    assert errors.count("Interrupted") == (1 if stuck == DEAF else 2)


def test_commands_run_outside_of_the_main_thread() -> None:
    """Outside of the main thread signals cannot be handled, and commands do without."""
    codes: list[int] = []
    thread = threading.Thread(target=lambda: codes.append(main(["info", "nowhere"])))
    thread.start()
    thread.join()
    assert codes == [1]


COLMAP = """
import sys, time
from splatreel.capture.readers.colmap_model import import_pycolmap
from splatreel.cli.failure import Terminated, termination

try:
    with termination():
        import_pycolmap()
        print("ready", flush=True)
        time.sleep(600)
except Terminated:
    sys.exit(143)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_colmap_does_not_mistake_a_signal_for_a_crash() -> None:
    pytest.importorskip("pycolmap")
    process = subprocess.Popen(
        [sys.executable, "-c", COLMAP], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.terminate()
    assert (process.wait(120), process.communicate()[1]) == (143, "")
