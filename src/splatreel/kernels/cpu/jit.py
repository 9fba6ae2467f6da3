"""How every CPU kernel is compiled, and the float32 constants they share.

A float64 literal, or an int times a float32, would promote a whole expression to float64 and halve the vector width,
hence named float32 constants. Numba's on-disk cache watches only the file a kernel is in: after changing a constant here,
delete the `__pycache__` folders.
"""

from typing import Any

import numpy as np

SERIAL: dict[str, Any] = {"fastmath": True, "cache": True, "error_model": "numpy"}
PARALLEL: dict[str, Any] = {**SERIAL, "parallel": True}

F = np.float32
U = np.uint64  # index type: with signed indices LLVM cannot rule out wrap-around and silently stops vectorizing
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)


def finite(depths: np.ndarray) -> np.ndarray:
    """Depths with 1e30 in place of infinity, which fast math does not know; float32."""
    return np.minimum(np.ascontiguousarray(depths, np.float32), F(1e30))
