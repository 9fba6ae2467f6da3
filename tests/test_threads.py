import subprocess
import sys
from collections.abc import Iterator

import cv2
import numba
import pytest
import torch

from splatreel import threads
from splatreel.cli.main import main
from splatreel.errors import UsageError


@pytest.fixture(autouse=True)
def as_before(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        monkeypatch.setenv(name, "1")
    monkeypatch.setattr(threads, "_limit", None)
    before = numba.get_num_threads(), torch.get_num_threads(), cv2.getNumThreads()
    yield
    numba.set_num_threads(before[0])
    torch.set_num_threads(before[1])
    cv2.setNumThreads(before[2])


def test_all_cores_unless_told_otherwise() -> None:
    threads.use(None)
    assert threads.count() == threads.available() >= 1


def test_what_is_loaded_follows() -> None:
    threads.use(1)
    assert (threads.count(), numba.get_num_threads(), torch.get_num_threads(), cv2.getNumThreads()) == (1, 1, 1, 1)


def test_what_is_loaded_later_follows() -> None:
    program = (
        "from splatreel import threads; threads.use(1)\n"
        "import numba, torch, cv2; print(numba.get_num_threads(), torch.get_num_threads(), cv2.getNumThreads())"
    )
    assert subprocess.check_output([sys.executable, "-c", program], text=True).split() == ["1", "1", "1"]


def test_numba_still_compiles_when_it_was_loaded_before() -> None:
    program = (
        "import os; os.environ.pop('NUMBA_NUM_THREADS', None)\n"
        "import numba, numpy\n"
        "add = numba.njit(parallel=True)(lambda a: (a + 1).sum())\n"
        "add(numpy.ones(4))\n"
        "from splatreel import threads; threads.use(1)\n"
        "print(add(numpy.ones(4, numpy.float32)), numba.get_num_threads())"
    )
    assert subprocess.check_output([sys.executable, "-c", program], text=True).split() == ["8.0", "1"]


@pytest.mark.parametrize("number", [0, -1, 10_000])
def test_more_than_there_are_or_none(number: int) -> None:
    with pytest.raises(
        UsageError, match=rf"--threads {number} is out of range: this process has \d+ cores?\. Choose 1 to"
    ):
        threads.use(number)
    assert threads.count() == threads.available()


def test_the_command_line_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    for verb in (["reconstruct", "x", "--out", "y"], ["bench", "kernels"], ["evaluate", "x", "y", "--out", "z"]):
        assert main([*verb, "--threads", "10000"]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err.startswith("Error: --threads 10000 is out of range")
        assert len(captured.err.splitlines()) == 1
