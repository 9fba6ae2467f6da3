"""Commands that get Ctrl-C or SIGTERM at random moments; `python -m tests.signals 20` tries all commands more often."""

import os
import subprocess
import sys

import pytest

PATIENCE = 60.0
"""Seconds within which each command must end. The limit of `tests.signals` is for an idle machine."""
NAMES = ["calibrate", "encode", "demo", "serve"]
"""Commands that wait for native code, train, film or listen."""
RUN = f"import sys; from tests.signals import run; sys.exit(run(2, {NAMES}, {PATIENCE}, longest=10.0))"


@pytest.mark.slow
@pytest.mark.kill
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")
def test_commands_end_soon_after_a_signal_at_any_moment() -> None:
    pytest.importorskip("pycolmap", reason="calibrates")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    ended = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, env=environment, timeout=1700)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    lines = [line.split(": ") for line in ended.stdout.splitlines() if " signals in " in line]
    assert {name for name, _ in lines} == set(NAMES)
    met = {name for name, text in lines if not text.startswith("0 ")}  # a short command may be over by then
    assert {"calibrate", "demo", "serve"} <= met, ended.stdout
