"""Boxes, ellipsoids and cylinders, and their ray intersections; compiled.

Numba's cache watches only the file of the called function, not of functions that it calls. After a change here or in
`textures`, save `raytracer` too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from toyroom.textures import albedo

BOX, ELLIPSOID, CYLINDER = 0, 1, 2
FAR = 1e9
EPSILON = 1e-4
"""Nearer hits are the surface on which the ray starts."""

# Columns of Shapes.solids. Numba passes arrays by value, so one array per attribute would make calls cost more than rays.
KIND, TEXTURE, SCALE, PHASE, OCCLUSION, REACH = range(6)
POSITION, HALF, ROTATION, COLORS, SOLID_COLUMNS = 6, 9, 12, 21, 30
# Columns of Shapes.bodies.
CENTER, RADIUS, FIRST, END, SHADOWS, BODY_COLUMNS = 0, 3, 4, 5, 6, 7


class Shapes(NamedTuple):
    """Solids, sorted by body.

    Attributes:
        solids: [N, 30] float64: KIND; TEXTURE with SCALE and PHASE; OCCLUSION, strength of ambient occlusion; REACH,
            radius of the bounding sphere; POSITION [3]; HALF [3] extents (a cylinder's axis is y); ROTATION [3 x 3]
            local to world; COLORS [3 x 3], linear.
        bodies: [B, 7] float64: CENTER [3] and RADIUS of a bounding sphere, FIRST solid and END, and whether it casts
            SHADOWS.
    """

    solids: np.ndarray
    bodies: np.ndarray


@njit(cache=True, error_model="numpy")
def three(array, i, k):
    """Return three neighboring numbers. A slice would update a reference count that all threads share."""
    return array[i, k], array[i, k + 1], array[i, k + 2]


@njit(cache=True, error_model="numpy")
def _to_local(shapes, i, x, y, z):
    R, k = shapes.solids, ROTATION
    return (
        R[i, k] * x + R[i, k + 3] * y + R[i, k + 6] * z,
        R[i, k + 1] * x + R[i, k + 4] * y + R[i, k + 7] * z,
        R[i, k + 2] * x + R[i, k + 5] * y + R[i, k + 8] * z,
    )


@njit(cache=True, error_model="numpy")
def _slab(o, d, half, low, high):
    """Return the range [low, high] of a ray's parameter for which |o + t d| <= half on one axis."""
    if abs(d) < 1e-12:
        return (low, high) if abs(o) <= half else (FAR, -FAR)
    a, b = (-half - o) / d, (half - o) / d
    return max(low, min(a, b)), min(high, max(a, b))


@njit(cache=True, error_model="numpy")
def _hit(shapes, i, ox, oy, oz, dx, dy, dz):
    """Return the distance along a unit ray to solid i from outside it, or FAR."""
    p, half, reach = three(shapes.solids, i, POSITION), three(shapes.solids, i, HALF), shapes.solids[i, REACH]
    ox, oy, oz = ox - p[0], oy - p[1], oz - p[2]
    along = ox * dx + oy * dy + oz * dz
    if along > reach or ox * ox + oy * oy + oz * oz - along * along > reach * reach:
        return FAR
    ox, oy, oz = _to_local(shapes, i, ox, oy, oz)
    dx, dy, dz = _to_local(shapes, i, dx, dy, dz)
    low, high = -FAR, FAR
    if shapes.solids[i, KIND] == BOX:
        low, high = _slab(ox, dx, half[0], low, high)
        low, high = _slab(oy, dy, half[1], low, high)
        low, high = _slab(oz, dz, half[2], low, high)
    else:
        ox, oz, dx, dz = ox / half[0], oz / half[2], dx / half[0], dz / half[2]
        a, b, c = dx * dx + dz * dz, ox * dx + oz * dz, ox * ox + oz * oz - 1
        if shapes.solids[i, KIND] == ELLIPSOID:
            oy, dy = oy / half[1], dy / half[1]
            a, b, c = a + dy * dy, b + oy * dy, c + oy * oy
        else:
            low, high = _slab(oy, dy, half[1], low, high)
        if a > 1e-12:
            root = b * b - a * c
            if root <= 0:
                return FAR
            root = math.sqrt(root)
            low, high = max(low, (-b - root) / a), min(high, (-b + root) / a)
        elif c > 0:
            return FAR
    return low if low <= high and low > EPSILON else FAR


@njit(cache=True, error_model="numpy")
def meets(shapes, body, ox, oy, oz, dx, dy, dz, limit, margin, widening):
    """Return whether a ray may hit a body's sphere, grown by margin + widening * distance, before `limit`."""
    c = three(shapes.bodies, body, CENTER)
    cx, cy, cz = c[0] - ox, c[1] - oy, c[2] - oz
    along = cx * dx + cy * dy + cz * dz
    radius = shapes.bodies[body, RADIUS] + margin + widening * max(along, 0.0)
    return along > -radius and along - radius < limit and cx * cx + cy * cy + cz * cz - along * along < radius * radius


@njit(cache=True, error_model="numpy")
def nearest(shapes, ox, oy, oz, dx, dy, dz, limit):
    """Return distance and index of the first solid before `limit`; index -1 if there is none."""
    best, index = limit, -1
    for body in range(len(shapes.bodies)):
        if meets(shapes, body, ox, oy, oz, dx, dy, dz, best, 0.0, 0.0):
            for i in range(int(shapes.bodies[body, FIRST]), int(shapes.bodies[body, END])):
                t = _hit(shapes, i, ox, oy, oz, dx, dy, dz)
                if t < best:
                    best, index = t, i
    return best, index


@njit(cache=True, error_model="numpy")
def blocked(shapes, ox, oy, oz, dx, dy, dz, limit):
    """Return whether a solid lies on a ray before `limit`."""
    for body in range(len(shapes.bodies)):
        if shapes.bodies[body, SHADOWS] > 0 and meets(shapes, body, ox, oy, oz, dx, dy, dz, limit, 0.0, 0.0):
            for i in range(int(shapes.bodies[body, FIRST]), int(shapes.bodies[body, END])):
                if _hit(shapes, i, ox, oy, oz, dx, dy, dz) < limit:
                    return True
    return False


@njit(cache=True, error_model="numpy")
def _normal(shapes, i, x, y, z):
    """Return the outward unit normal in local coordinates at a local surface point."""
    h = three(shapes.solids, i, HALF)
    if shapes.solids[i, KIND] == ELLIPSOID:
        nx, ny, nz = x / (h[0] * h[0]), y / (h[1] * h[1]), z / (h[2] * h[2])
    elif shapes.solids[i, KIND] == CYLINDER:
        if abs(y) > h[1] - 1e-6:
            return 0.0, math.copysign(1.0, y), 0.0
        nx, ny, nz = x / (h[0] * h[0]), 0.0, z / (h[2] * h[2])
    else:
        ax, ay, az = abs(x) / h[0], abs(y) / h[1], abs(z) / h[2]
        if ax >= ay and ax >= az:
            return math.copysign(1.0, x), 0.0, 0.0
        if ay >= az:
            return 0.0, math.copysign(1.0, y), 0.0
        return 0.0, 0.0, math.copysign(1.0, z)
    norm = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / norm, ny / norm, nz / norm


@njit(cache=True, error_model="numpy")
def surface(shapes, i, x, y, z):
    """Return the world normal and albedo at a world point on solid i."""
    a, R = shapes.solids, ROTATION
    x, y, z = _to_local(shapes, i, x - a[i, POSITION], y - a[i, POSITION + 1], z - a[i, POSITION + 2])
    nx, ny, nz = _normal(shapes, i, x, y, z)
    half, palette = three(a, i, HALF), (three(a, i, COLORS), three(a, i, COLORS + 3), three(a, i, COLORS + 6))
    r, g, b = albedo(a[i, TEXTURE], x, y, z, nx, ny, nz, half, palette, a[i, SCALE], a[i, PHASE])
    wx = a[i, R] * nx + a[i, R + 1] * ny + a[i, R + 2] * nz
    wy = a[i, R + 3] * nx + a[i, R + 4] * ny + a[i, R + 5] * nz
    wz = a[i, R + 6] * nx + a[i, R + 7] * ny + a[i, R + 8] * nz
    return wx, wy, wz, r, g, b
