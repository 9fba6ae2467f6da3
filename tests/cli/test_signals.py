"""Commands that get Ctrl-C or SIGTERM at random moments; `python -m tests.signals 20` does the same more often."""

import os
import subprocess
import sys

import pytest

PATIENCE = 60.0
"""Seconds within which each command must end. The limit of `tests.signals` is for an idle machine."""
RUN = f"import sys; from tests.signals import run; sys.exit(run(2, [], {PATIENCE}))"
NAMES = {"sequence", "chapters", "encode", "import", "publish", "evaluate", "film", "page", "frames"}
NAMES |= {"check", "calibrate", "demo", "verify", "serve", "kernels"}


@pytest.mark.slow
@pytest.mark.kill
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")
def test_every_command_ends_soon_after_a_signal_at_any_moment() -> None:
    pytest.importorskip("pycolmap", reason="calibrates")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    ended = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, env=environment, timeout=1700)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    lines = [line.split(": ") for line in ended.stdout.splitlines() if " signals in " in line]
    assert {name for name, _ in lines} == NAMES
    met = {name for name, text in lines if not text.startswith("0 ")}  # a short command may be over by then
    assert {"sequence", "calibrate", "demo", "serve"} <= met, ended.stdout
