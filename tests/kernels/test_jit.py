"""How kernels are compiled."""

import os
import subprocess
import sys
from pathlib import Path

DEFORM = """
import hashlib
import numpy as np
from splatreel.kernels.cpu.deform import DeformedPoints, _deform, forward
from splatreel.kernels.cpu.project import FINE_BLUR, Pinhole

rng = np.random.default_rng(0)
shapes = (3000, 3), (3000, 4), (3000, 3), (3000,), (3000, 1, 3), (3000, 3, 3), (0, 3), (0, 4), (0, 4)
points = DeformedPoints(*(0.5 * rng.normal(size=shape).astype(np.float32) for shape in shapes))
view = Pinhole(np.eye(4, dtype=np.float32), np.diag([60, 60, 1]).astype(np.float32), 48, 32, 0.1, FINE_BLUR)
opacities, seen = forward(points, np.array([0, 0, -4], np.float32), view)
print(len(_deform.stats.cache_hits), hashlib.sha256(b"".join(array.tobytes() for array in (opacities, *seen))).hexdigest())
"""


def test_who_compiles_a_kernel_calls_the_code_that_others_read_from_the_cache(tmp_path: Path) -> None:
    """Numba compiles a parallel loop twice, and fast math may add in another order the second time."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "NUMBA_CACHE_DIR": str(tmp_path)}
    ran = [
        subprocess.run([sys.executable, "-c", DEFORM], capture_output=True, text=True, env=environment, check=True)
        for _ in range(2)
    ]
    (compiled, first), (read, second) = (process.stdout.split() for process in ran)
    assert (compiled, read) == ("0", "1")
    assert first == second
