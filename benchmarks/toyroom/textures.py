"""Procedural textures of the built-in capture: smooth functions of a solid's local coordinates.

Their finest detail is a few pixels wide at the default size, which avoids aliasing. `GRAINED` textures are for large
images.
"""

from __future__ import annotations

import math

from numba import njit

SOLID, PLANKS, WALLPAPER, CHECKS, STRIPES, DOTS, RINGS, GLOBE, SECTORS, PAINTING, EMBLEM, BANDS, MIRROR = range(13)
GRAINED = 32
"""Added to a kind: brightness varies in spots of all sizes, as on stone, wood and cloth."""
_COARSEST, _OCTAVES, _DEEP = 5.0, 6, 0.45
"""Spots per unit of length of the largest size; number of sizes, each half as large; amplitude."""


@njit(cache=True, error_model="numpy")
def _step(x, width):
    """Return a smooth step from 0 to 1 around x = 0."""
    t = min(1.0, max(0.0, x / width + 0.5))
    return t * t * (3 - 2 * t)


@njit(cache=True, error_model="numpy")
def _hash(x, y, z):
    """Return a number in 0..1 for a lattice point."""
    h = (x * 374761393 + y * 668265263 + z * 1440662683) & 0x7FFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0x7FFFFFFF
    return ((h ^ (h >> 16)) & 0xFFFF) / 65535.0


@njit(cache=True, error_model="numpy")
def _noise(x, y, z):
    """Return value noise in 0..1 with features about one unit wide."""
    ix, iy, iz = math.floor(x), math.floor(y), math.floor(z)
    fx, fy, fz = x - ix, y - iy, z - iz
    fx, fy, fz = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy), fz * fz * (3 - 2 * fz)
    total = 0.0
    for corner in range(8):
        i, j, k = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (fx if i else 1 - fx) * (fy if j else 1 - fy) * (fz if k else 1 - fz)
        total += weight * _hash(int(ix) + i, int(iy) + j, int(iz) + k)
    return total


@njit(cache=True, error_model="numpy")
def _blend(a, b, t):
    return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t


@njit(cache=True, error_model="numpy")
def _times(color, k):
    return color[0] * k, color[1] * k, color[2] * k


@njit(cache=True, error_model="numpy")
def _planks(x, z, colors, scale, phase):
    """Return floorboards along z, each with its own tone and grain, separated by dark gaps."""
    u = x * scale + phase
    board = math.floor(u)
    along = z * scale * 0.28 + _hash(int(board), 7, 1) * 5
    tone = 0.6 * _hash(int(board), math.floor(along), 3) + 0.4 * _noise(u * 5, along * 3, board * 1.7)
    gap = _step(0.5 - abs(u - board - 0.5) - 0.03, 0.05) * _step(
        0.5 - abs(along - math.floor(along) - 0.5) - 0.008, 0.015
    )
    return _times(_blend(colors[0], colors[1], tone), 0.55 + 0.45 * gap)


@njit(cache=True, error_model="numpy")
def _wallpaper(u, v, colors, scale, phase):
    """Return broad stripes with a diamond on every other one."""
    s = u * scale + phase
    stripe = _step(abs(s - math.floor(s) - 0.5) - 0.25, 0.06)
    column = math.floor(s + 0.5)
    du = s - column
    w = v * scale + 0.5 * (int(column) % 2)
    dv = w - math.floor(w) - 0.5
    diamond = _step(0.17 - abs(du) * 1.2 - abs(dv) * 0.7, 0.05)
    dot = _step(0.045 - math.sqrt(du * du + dv * dv), 0.04)
    base = _blend(colors[0], colors[1], stripe)
    base = _blend(base, colors[2], diamond)
    return _blend(base, colors[0], dot)


@njit(cache=True, error_model="numpy")
def _globe(x, y, z, colors, scale, phase):
    """Return seas, land, ice caps and a few meridians; x, y, z on the unit sphere."""
    land = _noise(x * scale + phase, y * scale, z * scale) + 0.45 * _noise(
        x * scale * 2.3, y * scale * 2.3 + phase, z * scale * 2.3
    )
    height = _step(land - 0.76, 0.06)
    green = 0.55 + 0.6 * _noise(x * 5, y * 5 + 9, z * 5)
    color = _blend(colors[0], _times(colors[1], green), height)
    lines = abs(math.sin(3 * math.atan2(z, x)))
    color = _times(color, 0.78 + 0.22 * _step(lines - 0.05, 0.05))
    return _blend(color, colors[2], _step(abs(y) - 0.86 + 0.1 * _noise(x * 4, y, z * 4), 0.05))


@njit(cache=True, error_model="numpy")
def _painting(u, v, colors):
    """Return a sunset over hills; u, v in -1..1, v up."""
    sky = _blend(colors[0], colors[1], min(1.0, max(0.0, 0.55 + 0.5 * v)))
    du, dv = u - 0.35, (v - 0.28) * 0.75
    color = _blend(sky, (1.0, 0.75, 0.25), _step(0.27 - math.sqrt(du * du + dv * dv), 0.06))
    for i in range(3):
        ridge = -0.12 - 0.26 * i + 0.2 * math.sin(u * (2.3 + i) + 1.7 * i) + 0.06 * math.sin(u * 7 + i)
        color = _blend(color, _times(colors[2], 1.15 - 0.34 * i), _step(ridge - v, 0.07))
    return color


@njit(cache=True, error_model="numpy")
def _emblem(u, v, face, colors):
    """Return a toy block's face: a frame and one of three figures; u, v in -1..1."""
    frame = _step(max(abs(u), abs(v)) - 0.76, 0.08)
    r, angle = math.sqrt(u * u + v * v), math.atan2(v, u)
    if face == 0:
        figure = _step(0.40 + 0.16 * math.cos(5 * angle) - r, 0.09)
    elif face == 1:
        figure = _step(0.5 - r, 0.09) * _step(r - 0.22, 0.09)
    else:
        figure = _step(0.17 - min(abs(u), abs(v)), 0.09) * _step(0.56 - max(abs(u), abs(v)), 0.09)
    return _blend(_blend(colors[0], colors[1], frame), colors[2], figure)


@njit(cache=True, error_model="numpy")
def _grain(x, y, z):
    """Return a factor around 1: value noise of several sizes, smaller ones fainter, about as in photographs."""
    total, frequency, amplitude, most = 0.0, _COARSEST, 1.0, 0.0
    for _ in range(_OCTAVES):
        total += amplitude * (2 * _noise(x * frequency, y * frequency, z * frequency) - 1)
        most += amplitude
        frequency, amplitude = 2 * frequency, 0.75 * amplitude
    return 1 + 2 * _DEEP * total / most


@njit(cache=True, error_model="numpy")
def albedo(kind, x, y, z, nx, ny, nz, half, colors, scale, phase):
    """Return the linear color of a texture at a local point with a local normal; see the constants above for the kinds."""
    if kind < GRAINED:
        return _pattern(kind, x, y, z, nx, ny, nz, half, colors, scale, phase)
    color = _pattern(kind - GRAINED, x, y, z, nx, ny, nz, half, colors, scale, phase)
    return _times(color, _grain(x + phase, y, z))


@njit(cache=True, error_model="numpy")
def _pattern(kind, x, y, z, nx, ny, nz, half, colors, scale, phase):
    """Return the color of a texture without grain."""
    ax, ay, az = abs(nx), abs(ny), abs(nz)
    face = 0 if ax >= ay and ax >= az else (1 if ay >= az else 2)
    u, v, hu, hv = (
        (z, y, half[2], half[1]) if face == 0 else ((x, z, half[0], half[2]) if face == 1 else (x, y, half[0], half[1]))
    )
    if kind == PLANKS:
        return _planks(x, z, colors, scale, phase)
    if kind == WALLPAPER:
        return _wallpaper(u, v, colors, scale, phase)
    if kind == CHECKS:
        wave = math.sin(u * scale + phase) * math.sin(v * scale + phase)
        return _blend(colors[0], colors[1], _step(wave, 0.35))
    if kind == STRIPES:
        return _blend(colors[0], colors[1], _step(math.sin(y * scale + phase), 0.5))
    if kind == BANDS:
        return _blend(colors[0], colors[1], _step(0.09 - abs(abs(y) / half[1] - scale), 0.1))
    if kind == DOTS:
        du, dv = u * scale + phase - math.floor(u * scale + phase) - 0.5, v * scale - math.floor(v * scale) - 0.5
        return _blend(colors[0], colors[1], _step(0.27 - math.sqrt(du * du + dv * dv), 0.12))
    if kind == RINGS:
        r = math.sqrt(x * x + z * z)
        petals = 0.05 * math.cos(12 * math.atan2(z, x)) * _step(r - 0.3, 0.2)
        color = _blend(colors[0], colors[1], _step(math.sin((r + petals) * scale + phase), 0.5))
        return _blend(color, colors[2], _step(math.sqrt((x / half[0]) ** 2 + (z / half[2]) ** 2) - 0.92, 0.04))
    if kind == GLOBE:
        return _globe(x / half[0], y / half[1], z / half[2], colors, scale, phase)
    if kind == SECTORS:
        wave = math.sin(scale * math.atan2(z, x) + phase)
        color = _blend(colors[0], colors[1], _step(wave, 0.35))
        return _blend(color, colors[2], _step(ay - 0.88, 0.08))
    if kind == PAINTING:
        return _painting(u / hu, v / hv, colors)
    if kind == EMBLEM:
        return _emblem(u / hu, v / hv, face, colors)
    return colors[0]
