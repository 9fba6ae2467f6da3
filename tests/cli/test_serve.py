"""`splatreel serve` as a process of its own: answers, and ends well with Ctrl-C."""

import json
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from splatreel.cli.main import main

GOLDEN = Path(__file__).parent.parent / "data" / "golden"


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent as a POSIX signal")
def test_serve_answers_until_ctrl_c() -> None:
    command = [sys.executable, "-m", "splatreel", "serve", str(GOLDEN), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, line
        with urllib.request.urlopen(found[0], timeout=10) as answer:
            assert b"<html" in answer.read().lower()
        with urllib.request.urlopen(f"{found[0]}reel/manifest.json", timeout=10) as answer:
            assert json.load(answer)["format"] == "splatreel"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
    assert process.returncode == 0
    assert errors == ""


def test_serving_what_is_no_reel(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", str(tmp_path)]) == 1
    assert "is not a reel" in capsys.readouterr().err
