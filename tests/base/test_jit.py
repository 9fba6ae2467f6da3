"""Kernels: one signature each, a cache on disk, and results that do not depend on the number of threads."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from splatreel.base import jit, threads

PROGRAM = """
import numpy as np
from splatreel.kernels import motion
kernel = motion._normalize
before = kernel.is_cached()
units = np.empty((3, 5), np.float32)
kernel.over(3, np.ones((3, 4), np.float32), units)
stats = kernel.dispatcher.stats
print(before, kernel.is_cached(), sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), units.tobytes().hex())
"""


@jit.range_kernel(jit.F1, jit.FLOAT, jit.F1)
def _scale(first, last, values, factor, out):
    for i in range(first, last):
        out[i] = factor * values[i]


def test_kernel_runs_over_all_items() -> None:
    values, out = np.arange(1000, dtype=np.float32), np.zeros(1000, np.float32)
    for number in (1, 2, 16):
        out[:] = 0
        with threads.limited(number):
            _scale.over(1000, values, np.float32(0.5), out)
        np.testing.assert_array_equal(out, values / 2)


def test_kernel_rejects_second_signature() -> None:
    values = np.arange(10, dtype=np.float64)
    with pytest.raises(TypeError, match=r"[Nn]o matching definition"):
        _scale.over(10, values, np.float32(0.5), values)
    assert len(_scale.dispatcher.signatures) == 1


def test_kernel_is_compiled_once_for_all_processes(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "NUMBA_CACHE_DIR": str(tmp_path)}
    ran = [
        subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, env=environment, check=True)
        for _ in range(2)
    ]
    (first_cached, *first), (second_cached, *second) = (process.stdout.split() for process in ran)
    assert (first_cached, first[:3]) == ("False", ["True", "0", "1"])
    assert (second_cached, second[:3]) == ("True", ["True", "1", "0"])
    assert first[3] == second[3]


def test_kernel_waits_for_warmup() -> None:
    waited: list[str] = []

    class Warmup:
        def wait_for(self, kernel: str) -> None:
            waited.append(kernel)

    @jit.kernel(jit.FLOAT, options={"error_model": "numpy"})
    def _double(value):
        return value + value

    jit.use_warmup(Warmup())
    try:
        assert _double(np.float32(2)) == 4
        assert _double(np.float32(3)) == 6
    finally:
        jit.use_warmup(None)
    assert [name.split(".")[-1] for name in waited] == ["double"]


def test_first_call_says_that_it_compiles(tmp_path: Path) -> None:
    """The line is printed where a program set up no logging, once, and only if the kernel is not in the cache."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "NUMBA_CACHE_DIR": str(tmp_path)}
    said = [
        subprocess.run(
            [sys.executable, "-c", PROGRAM], capture_output=True, text=True, env=environment, check=True
        ).stderr
        for _ in range(2)
    ]
    assert said == ["Compiling kernels for this processor. This happens once and takes up to a minute.\n", ""]
