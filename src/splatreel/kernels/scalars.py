"""Float32 constants of the CPU kernels.

A float64 literal, or an int times a float32, would promote a whole expression to float64 and halve the vector width. Numba's cache on
disk notices changes only in a kernel's own file. After changing a constant here, delete the `__pycache__` folders.
"""

import numpy as np
from numba import njit

F = np.float32
U = np.uint64  # index type, because with signed indices LLVM cannot rule out wrap-around and stops vectorizing
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)


@njit(inline="always")
def sign(value):
    """Return -1, 0 or 1 as float32."""
    return ONE if value > ZERO else (-ONE if value < ZERO else ZERO)


def finite(depths: np.ndarray) -> np.ndarray:
    """Return depths as float32 with 1e30 in place of infinity, which fast math does not support."""
    return np.minimum(np.ascontiguousarray(depths, np.float32), F(1e30))
