"""Shape of a Gaussian as six numbers: the logarithm of the square root of its covariance, R diag(log2 s) R^T.

The six numbers do not depend on the order or the sign of the axes. A rotation changes them more for longer Gaussians,
and neighbors on a surface have similar numbers. They are coordinates in an orthonormal basis of the symmetric matrices,
except that the size counts sqrt 2 times as much.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from splatreel.base.jit import EXACT
from splatreel.scene import rotations

NUMBERS = 6
LARGEST = 126
"""Maximum absolute octave that float32 holds."""
_XX, _XY, _XZ, _YY, _YZ, _ZZ = range(6)
_X, _Y, _Z = 1, 2, 3
_SWEEPS = 12
_NOTHING = 1e-18
"""Share of a matrix's squared norm that off-diagonal elements may keep, far below float32 precision."""


def of_shapes(quats: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return [N, 6] float64 of rotations [N, 4] and scales [N, 3]: size, x against y, z against both, then xy, xz, yz."""
    turns = rotations.to_matrix(rotations.normalize(quats.astype(np.float64)))
    octaves = np.log2(np.maximum(scales.astype(np.float64), 1e-30))
    xx, xy, xz, _, yy, yz, _, _, zz = ((turns * octaves[:, None]) @ turns.transpose(0, 2, 1)).reshape(-1, 9).T
    parts = (xx + yy + zz) * np.sqrt(2 / 3), (xx - yy) / np.sqrt(2), (2 * zz - xx - yy) / np.sqrt(6)
    return np.stack([*parts, xy * np.sqrt(2), xz * np.sqrt(2), yz * np.sqrt(2)], 1)


@njit(**EXACT)
def to_shapes(numbers):
    """Return unit quaternions [N, 4] and scales [N, 3], float64, of numbers [N, 6], by Jacobi rotations in the order of the format."""
    count = len(numbers)
    quats, scales = np.empty((count, 4)), np.empty((count, 3))
    root2, root6 = np.sqrt(2.0), np.sqrt(6.0)
    m, q = np.empty(6), np.empty(4)
    for i in range(count):
        size, across, along = numbers[i, 0] / root6, numbers[i, 1] / root2, numbers[i, 2] / root6
        m[_XX], m[_YY], m[_ZZ] = size - along + across, size - along - across, size + 2 * along
        m[_XY], m[_XZ], m[_YZ] = numbers[i, 3] / root2, numbers[i, 4] / root2, numbers[i, 5] / root2
        q[0], q[1], q[2], q[3] = 1.0, 0.0, 0.0, 0.0
        _diagonalize(m, q)
        quats[i] = q / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        for k, octaves in enumerate((m[_XX], m[_YY], m[_ZZ])):
            scales[i, k] = 2.0 ** min(max(octaves, -LARGEST), LARGEST)
    return quats, scales


@njit(**EXACT)
def _diagonalize(m, q):
    """Rotate the axes of m until it is diagonal; q becomes that rotation."""
    for _ in range(_SWEEPS):
        rest = m[_XY] * m[_XY] + m[_XZ] * m[_XZ] + m[_YZ] * m[_YZ]
        whole = m[_XX] * m[_XX] + m[_YY] * m[_YY] + m[_ZZ] * m[_ZZ]
        if rest <= _NOTHING * whole:
            return
        _turn(m, q, _XX, _YY, _XY, _XZ, _YZ, _X, _Y, _Z)
        _turn(m, q, _ZZ, _XX, _XZ, _YZ, _XY, _Z, _X, _Y)
        _turn(m, q, _YY, _ZZ, _YZ, _XY, _XZ, _Y, _Z, _X)


@njit(**EXACT)
def _turn(m, q, aa, bb, ab, ac, bc, a, b, c):
    """Rotate about axis c so that m becomes zero at axes a and b. The other arguments are the positions of these axes in m and q."""
    off = m[ab]
    if off == 0:
        return
    half = (m[bb] - m[aa]) / (2 * off)
    tangent = 1 / (abs(half) + np.sqrt(half * half + 1))
    if half < 0:
        tangent = -tangent
    cosine = 1 / np.sqrt(tangent * tangent + 1)
    sine = tangent * cosine
    m[aa], m[bb], m[ab] = m[aa] - tangent * off, m[bb] + tangent * off, 0.0
    m[ac], m[bc] = cosine * m[ac] - sine * m[bc], sine * m[ac] + cosine * m[bc]
    # The new axes are cosine a - sine b and sine a + cosine b: a rotation about c by the negative angle, multiplied from the right.
    w = np.sqrt((1 + cosine) / 2)
    v = -sine / (2 * w)
    q[0], q[a], q[b], q[c] = w * q[0] - v * q[c], w * q[a] + v * q[b], w * q[b] - v * q[a], w * q[c] + v * q[0]
