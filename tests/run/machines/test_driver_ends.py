"""Workers end with their driver, however it ends, and the run continues from what they finished."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.run.test_pipeline import content

DRIVER = """
import multiprocessing, sys
from pathlib import Path
from splatreel.base import threads
from splatreel.cli.failure import termination
from splatreel.base.progress import Silent
from splatreel.run.machines.local_processes import reconstruct_here
from tests.run.machines.runs import spec

class Tell(Silent):
    told = False
    def update(self, done, **numbers):
        if not self.told:
            self.told = True
            print(*(child.pid for child in multiprocessing.active_children()), flush=True)

threads.count = lambda: 2
try:
    with termination():
        reconstruct_here(spec(Path(sys.argv[1])), workers=2, progress=Tell())
except KeyboardInterrupt:
    sys.exit(130)
"""


def start(out: Path) -> tuple[subprocess.Popen[str], list[int]]:
    """A driver in a process group of its own, and its two workers."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    driver = subprocess.Popen([sys.executable, "-c", DRIVER, str(out)], env=environment, process_group=0, **pipes)
    assert driver.stdout is not None
    return driver, [int(word) for word in driver.stdout.readline().split()]


def runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
@pytest.mark.kill
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
def test_workers_end_and_the_run_continues(out: Path, expected: dict[str, str]) -> None:
    for number, code in ((signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)):
        driver, workers = start(out)
        assert len(workers) == 2
        if number == signal.SIGKILL:
            driver.kill()
        else:
            os.killpg(driver.pid, number)  # as a terminal does
        errors = driver.communicate(timeout=600)[1]
        assert driver.returncode == code, errors
        assert "Traceback" not in errors
        end = time.monotonic() + 120
        while any(runs(pid) for pid in workers) and time.monotonic() < end:
            time.sleep(0.1)
        assert not any(runs(pid) for pid in workers)
    driver, _ = start(out)
    errors = driver.communicate(timeout=600)[1]
    assert driver.returncode == 0, errors
    assert content(out / "reel") == expected
