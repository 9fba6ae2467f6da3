"""Verbs that are killed by SIGKILL; `benchmarks/kills.py` does the same many times."""

import os
import subprocess
import sys

import pytest

from tests.kills import NAMES

KILLS = {"sequence": 3, "chapters": 2}
"""Of the others one each."""


@pytest.mark.kill
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")
def test_killed_at_random_moments_or_on_a_full_disk_every_verb_goes_on_to_the_bytes_of_an_undisturbed_run() -> None:
    counts = [f"{name}={KILLS.get(name, 1)}" for name in NAMES]
    # Coverage would write files of its own, at moments that are counted and on the disk that is full.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    command = [sys.executable, "-m", "tests.kills", *counts]
    ended = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=1700)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    lines = [line for line in ended.stdout.splitlines() if not line.startswith(" ")]
    assert [line.split(": ")[0] for line in lines] == list(NAMES)
    assert all(
        "; killed in " in line and "; 2 full disks; " in line and line.endswith("files that differ: none")
        for line in lines
    ), ended.stdout
