import subprocess
import sys
from pathlib import Path

import pytest

TAKE_AND_FREE = """
import numpy as np
from benchmarks.resident import resident_of
from splatreel.base.process import give_back_freed_memory, keep_freed_memory

keep_freed_memory()
held = [np.ones(1 << 17) for _ in range(200)]  # a megabyte each
kept = held[::10]
most = resident_of("self")
held.clear()
after = resident_of("self")
give_back_freed_memory()
print(most - after, most - resident_of("self"))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc keeps memory so")
def test_freed_memory_is_kept_until_returned() -> None:
    root = Path(__file__).parent.parent
    done = subprocess.run([sys.executable, "-c", TAKE_AND_FREE], capture_output=True, text=True, check=True, cwd=root)
    before, after = map(int, done.stdout.split())
    assert before < 20e6
    assert after > 150e6
