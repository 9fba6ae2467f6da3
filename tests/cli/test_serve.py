"""`splatreel serve` as a process of its own: answers, and ends well with Ctrl-C."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import threading
import urllib.request
from pathlib import Path

import pytest

from splatreel.cli.main import main
from splatreel.cli.serve import has_browser, open_browser
from splatreel.play.server import Server

GOLDEN = Path(__file__).parent.parent / "data" / "golden"


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent as a POSIX signal")
def test_serve_answers_until_ctrl_c() -> None:
    command = [sys.executable, "-m", "splatreel", "serve", str(GOLDEN), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, line
        with urllib.request.urlopen(found[0], timeout=60) as answer:
            assert b"<html" in answer.read().lower()
        with urllib.request.urlopen(f"{found[0]}reel/manifest.json", timeout=60) as answer:
            assert json.load(answer)["format"] == "splatreel"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    assert process.returncode == 0
    assert errors == ""


def test_serving_another_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", str(tmp_path)]) == 1
    assert "is not a reel" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent as a POSIX signal")
def test_view_without_a_browser_prints_the_address() -> None:
    command = [sys.executable, "-m", "splatreel", "view", str(GOLDEN), "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        found = re.search(r"http://127.0.0.1:\d+/", process.stdout.readline())
        assert found
        with urllib.request.urlopen(found[0], timeout=60) as answer:
            assert b"player.js" in answer.read()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=120)
    assert process.returncode == 0


def test_view_opens_the_browser(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    opened: list[str] = []
    seen = threading.Event()
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.get", lambda: None)
    monkeypatch.setattr("webbrowser.open", lambda url: (opened.append(url), seen.set()))
    monkeypatch.setattr("splatreel.play.server.Server.wait", lambda self: seen.wait(60))
    assert main(["view", str(GOLDEN)]) == 0
    assert opened[0] in capsys.readouterr().out
    assert main(["view", str(GOLDEN), "--no-open"]) == 0
    assert len(opened) == 1


def test_view_on_cpu_needs_the_viewer_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", str(GOLDEN), "--renderer", "cpu", "--no-open"]) == 1
    assert 'pip install "splatreel[viewer]"' in capsys.readouterr().err


def test_drawing_on_cuda_needs_a_device(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("splatreel.run.device_choice._has_gsplat", lambda: True)
    monkeypatch.setattr("splatreel.run.device_choice._why_no_cuda", lambda: "PyTorch finds no CUDA device")
    assert main(["view", str(GOLDEN), "--renderer", "cuda", "--no-open"]) == 2
    assert "--renderer cpu" in capsys.readouterr().err


def test_serve_shows_phones_the_self_test(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("splatreel.play.server.Server.wait", lambda self: None)
    monkeypatch.setattr("splatreel.play.server._network_address", lambda everywhere: "192.0.2.7")
    assert main(["serve", str(GOLDEN), "--port", "0", "--host", "0.0.0.0"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"Test a phone in this network: http://192\.0\.2\.7:\d+/self-test\.html", printed)
    assert "█" not in printed, "this is no terminal"
    assert main(["serve", str(GOLDEN), "--port", "0"]) == 0
    assert "phone" not in capsys.readouterr().out, "no phone is let in"


def test_view_plays_the_sample(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    served: list[str] = []

    def read(server: Server) -> None:
        with urllib.request.urlopen(f"{server.url}reel/manifest.json", timeout=60) as answer:
            served.append(answer.read().decode())

    monkeypatch.setattr("splatreel.play.demo_page.SAMPLE", GOLDEN)
    monkeypatch.setattr(Server, "wait", read)
    assert main(["view", "--sample", "--no-open"]) == 0
    assert served == [(GOLDEN / "manifest.json").read_text()]
    for arguments in ([], [str(GOLDEN), "--sample"]):
        assert main(["view", *arguments]) == 2
        assert "Name either a reel or --sample" in capsys.readouterr().err


def test_view_of_a_sample_that_is_not_installed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("splatreel.play.demo_page.SAMPLE", tmp_path)
    assert main(["view", "--sample"]) == 1
    assert "has no sample reel. `splatreel demo --out OUT` makes such a reel" in capsys.readouterr().err


WINDOWS = ("BROWSER", "DISPLAY", "WAYLAND_DISPLAY", "WSL_DISTRO_NAME")


@pytest.fixture(autouse=True)
def linux(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr("webbrowser.get", lambda: None)
    for name in WINDOWS:
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize("name", WINDOWS)
def test_a_window_or_a_chosen_browser_is_enough(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    assert not has_browser(), "a browser in the terminal would take it over"
    monkeypatch.setenv(name, "something")
    assert has_browser()


def test_without_a_browser_nothing_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("webbrowser.open", lambda url: pytest.fail("opened"))
    assert not open_browser("http://localhost/")


def test_opening_does_not_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, ended = threading.Event(), threading.Event()

    def start(url: str) -> None:
        begun.set()
        ended.wait(60)

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", start)
    assert open_browser("http://localhost/")
    assert begun.wait(60)
    ended.set()
