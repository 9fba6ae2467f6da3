"""Which threads the kernels run on."""

import os
import subprocess
import sys

PROGRAM = """
import splatreel.kernels.splat
from numba.core import config
print(config.THREADING_LAYER_PRIORITY[0])
"""


def first_choice(environment: dict[str, str]) -> str:
    found = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, env=environment)
    return found.stdout.strip()


def test_openmp_comes_before_tbb_unless_one_says_otherwise():
    """TBB's workers spin while they wait, and numba would take it first wherever the system has it."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_THREADING")}
    assert first_choice(plain) == "omp"
    assert first_choice(plain | {"NUMBA_THREADING_LAYER_PRIORITY": "tbb omp workqueue"}) == "tbb"
