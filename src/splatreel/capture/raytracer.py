"""A small ray tracer for the built-in capture: boxes, ellipsoids and cylinders, matte or mirror, under one soft light.

It shares nothing with the splatting code, so that a reconstruction is judged against something that knows no Gaussians.
What stands still is traced once a camera; a frame then traces only the rays, and the shadow rays, that may meet what moves.
World and camera conventions are those of `scene.camera`; lengths are world units, colours linear 0..1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from splatreel.capture.textures import MIRROR, albedo
from splatreel.scene.camera import Camera

BOX, ELLIPSOID, CYLINDER = 0, 1, 2
SAMPLES = 4
"""Rays an edge of a pixel: 4 x 4 a pixel."""
FAR = 1e9
EPSILON = 1e-4
LIGHT_SIZE = 0.5


class Shapes(NamedTuple):
    """Solids as arrays. kind: [N]. position: [N, 3]. rotation: [N, 3, 3] local to world. half: [N, 3] half extents (a cylinder's
    axis is y). texture: [N]. colors: [N, 3, 3], three linear colours a solid. scale, phase: [N], the texture's.
    occlusion: [N], how strongly a solid darkens the ambient light around it.
    """

    kind: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    half: np.ndarray
    texture: np.ndarray
    colors: np.ndarray
    scale: np.ndarray
    phase: np.ndarray
    occlusion: np.ndarray


class Still(NamedTuple):
    """What one camera sees of the standing solids, per sub-sample [H, W, S*S].

    depth: distance along the unit ray. point: [..., 3]. ambient, direct: [..., 3] light reflected from the surroundings and
    straight from the lamp. mirror: index of the mirror hit, or -1.
    """

    depth: np.ndarray
    point: np.ndarray
    ambient: np.ndarray
    direct: np.ndarray
    mirror: np.ndarray


@njit(cache=True, inline="always")
def _to_local(shapes, i, x, y, z):
    R = shapes.rotation[i]
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@njit(cache=True)
def _slab(o, d, half, low, high):
    """The part [low, high] of a ray's parameter for which |o + t d| <= half, on one axis."""
    if abs(d) < 1e-12:
        return (low, high) if abs(o) <= half else (FAR, -FAR)
    a, b = (-half - o) / d, (half - o) / d
    return max(low, min(a, b)), min(high, max(a, b))


@njit(cache=True)
def _hit(shapes, i, ox, oy, oz, dx, dy, dz):
    """Distance along a unit ray to solid i from outside it, or FAR."""
    p, half = shapes.position[i], shapes.half[i]
    cx, cy, cz = p[0] - ox, p[1] - oy, p[2] - oz
    radius2 = half[0] * half[0] + half[1] * half[1] + half[2] * half[2]
    along = cx * dx + cy * dy + cz * dz
    if cx * cx + cy * cy + cz * cz - along * along > radius2:
        return FAR
    ox, oy, oz = _to_local(shapes, i, -cx, -cy, -cz)
    dx, dy, dz = _to_local(shapes, i, dx, dy, dz)
    low, high = -FAR, FAR
    if shapes.kind[i] == BOX:
        low, high = _slab(ox, dx, half[0], low, high)
        low, high = _slab(oy, dy, half[1], low, high)
        low, high = _slab(oz, dz, half[2], low, high)
    else:
        ox, oz, dx, dz = ox / half[0], oz / half[2], dx / half[0], dz / half[2]
        a, b, c = dx * dx + dz * dz, ox * dx + oz * dz, ox * ox + oz * oz - 1
        if shapes.kind[i] == ELLIPSOID:
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


@njit(cache=True)
def _nearest(shapes, ox, oy, oz, dx, dy, dz, limit):
    """(distance, index) of the first solid before `limit`; index -1 if there is none."""
    best, index = limit, -1
    for i in range(len(shapes.kind)):
        t = _hit(shapes, i, ox, oy, oz, dx, dy, dz)
        if t < best:
            best, index = t, i
    return best, index


@njit(cache=True)
def _normal(shapes, i, x, y, z):
    """Outward unit normal in local coordinates at a local point of the surface."""
    h = shapes.half[i]
    if shapes.kind[i] == ELLIPSOID:
        nx, ny, nz = x / (h[0] * h[0]), y / (h[1] * h[1]), z / (h[2] * h[2])
    elif shapes.kind[i] == CYLINDER:
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


@njit(cache=True)
def _surface(shapes, i, x, y, z):
    """World normal and albedo at a world point on solid i."""
    p, R = shapes.position[i], shapes.rotation[i]
    lx, ly, lz = _to_local(shapes, i, x - p[0], y - p[1], z - p[2])
    nx, ny, nz = _normal(shapes, i, lx, ly, lz)
    r, g, b = albedo(
        shapes.texture[i], lx, ly, lz, nx, ny, nz, shapes.half[i], shapes.colors[i], shapes.scale[i], shapes.phase[i]
    )
    wx = R[0, 0] * nx + R[0, 1] * ny + R[0, 2] * nz
    wy = R[1, 0] * nx + R[1, 1] * ny + R[1, 2] * nz
    wz = R[2, 0] * nx + R[2, 1] * ny + R[2, 2] * nz
    return wx, wy, wz, r, g, b


@njit(cache=True)
def _openness(shapes, me, x, y, z, nx, ny, nz):
    """Share of the ambient light that the other solids leave: each counts as the sphere of its extent."""
    light = 1.0
    for i in range(len(shapes.kind)):
        if i != me and shapes.occlusion[i] > 0:
            p, h = shapes.position[i], shapes.half[i]
            cx, cy, cz = p[0] - x, p[1] - y, p[2] - z
            d2 = cx * cx + cy * cy + cz * cz
            r2 = (h[0] * h[1] * h[2]) ** (2.0 / 3.0)
            cosine = (cx * nx + cy * ny + cz * nz) / math.sqrt(d2 + 1e-9)
            light *= 1 - shapes.occlusion[i] * max(0.0, min(1.0, 0.35 + 0.65 * cosine)) * r2 / (r2 + d2)
    return light


@njit(cache=True)
def _lamp(light, sample, x, y, z):
    """Unit direction and distance from a point to the part of the lamp that this sub-sample sees.

    The parts are sixteen rooks on the lamp's square, so that a shadow's edge has sixteen steps in either direction.
    """
    n = SAMPLES * SAMPLES
    lx = light[0] + ((sample * 7 % n + 0.5) / n - 0.5) * LIGHT_SIZE - x
    ly = light[1] - y
    lz = light[2] + ((sample * 5 % n + 0.5) / n - 0.5) * LIGHT_SIZE - z
    distance = math.sqrt(lx * lx + ly * ly + lz * lz)
    return lx / distance, ly / distance, lz / distance, distance


@njit(cache=True)
def _lit(still, shapes, i, me, light, sample, x, y, z):
    """(ambient rgb, direct rgb) leaving solid i of `shapes` at a point; only `still` casts shadows and occludes.

    me: the solid's index among the standing ones, which it does not darken itself, or -1.
    """
    nx, ny, nz, r, g, b = _surface(shapes, i, x, y, z)
    open_sky = _openness(still, me, x, y, z, nx, ny, nz)
    up = 0.5 + 0.5 * ny
    ar, ag, ab = open_sky * (0.30 + 0.16 * up), open_sky * (0.27 + 0.21 * up), open_sky * (0.25 + 0.27 * up)
    sx, sy, sz, distance = _lamp(light, sample, x, y, z)
    cosine = nx * sx + ny * sy + nz * sz
    power = 0.0
    if cosine > 0:
        blocked = _nearest(still, x, y, z, sx, sy, sz, distance)[1] >= 0
        power = 0.0 if blocked else cosine
    return r * ar, g * ag, b * ab, r * power * 1.02, g * power * 0.93, b * power * 0.80


@njit(cache=True)
def _shade(still, moving, of_moving, i, light, sample, x, y, z):
    """Colour leaving solid i at a point, with the shadows of everything."""
    if of_moving:
        ar, ag, ab, r, g, b = _lit(still, moving, i, -1, light, sample, x, y, z)
    else:
        ar, ag, ab, r, g, b = _lit(still, still, i, i, light, sample, x, y, z)
    if r + g + b > 0:
        sx, sy, sz, distance = _lamp(light, sample, x, y, z)
        if _nearest(moving, x, y, z, sx, sy, sz, distance)[1] >= 0:
            r, g, b = 0.0, 0.0, 0.0
    return ar + r, ag + g, ab + b


@njit(cache=True)
def _ray(camera, row, col, sample):
    """Unit world direction through a sub-sample. camera: [6, 3] as `_pack` makes it."""
    u = (col + (sample % SAMPLES + 0.5) / SAMPLES - camera[4, 0]) / camera[5, 0]
    v = (row + (sample // SAMPLES + 0.5) / SAMPLES - camera[4, 1]) / camera[5, 1]
    x = camera[1, 0] * u + camera[2, 0] * v + camera[3, 0]
    y = camera[1, 1] * u + camera[2, 1] * v + camera[3, 1]
    z = camera[1, 2] * u + camera[2, 2] * v + camera[3, 2]
    norm = math.sqrt(x * x + y * y + z * z)
    return x / norm, y / norm, z / norm


@njit(cache=True)
def _sky(dy):
    """What a ray that leaves the room sees, by the height of its direction."""
    up = min(1.0, max(0.0, 0.5 + dy))
    return 0.42 + 0.2 * up, 0.44 + 0.24 * up, 0.46 + 0.32 * up


@njit(cache=True, parallel=True)
def _trace_still(camera, height, width, light, still, depth, point, ambient, direct, mirror):
    for row in prange(height):
        for col in range(width):
            for s in range(SAMPLES * SAMPLES):
                dx, dy, dz = _ray(camera, row, col, s)
                t, i = _nearest(still, camera[0, 0], camera[0, 1], camera[0, 2], dx, dy, dz, FAR)
                depth[row, col, s] = t
                mirror[row, col, s] = -1
                if i < 0:
                    r, g, b = _sky(dy)
                    ambient[row, col, s] = (r, g, b)
                    continue
                x, y, z = camera[0, 0] + t * dx, camera[0, 1] + t * dy, camera[0, 2] + t * dz
                point[row, col, s] = (x, y, z)
                if still.texture[i] == MIRROR:
                    mirror[row, col, s] = i
                    continue
                ar, ag, ab, r, g, b = _lit(still, still, i, i, light, s, x, y, z)
                ambient[row, col, s] = (ar, ag, ab)
                direct[row, col, s] = (r, g, b)


@njit(cache=True)
def _reflect(still, moving, i, light, s, x, y, z, dx, dy, dz):
    """Colour seen in mirror i of the standing solids; a mirror in the mirror shows the sky."""
    nx, ny, nz, r, g, b = _surface(still, i, x, y, z)
    k = 2 * (dx * nx + dy * ny + dz * nz)
    dx, dy, dz = dx - k * nx, dy - k * ny, dz - k * nz
    t, j = _nearest(still, x, y, z, dx, dy, dz, FAR)
    t, m = _nearest(moving, x, y, z, dx, dy, dz, t)
    if m >= 0:
        mr, mg, mb = _shade(still, moving, True, m, light, s, x + t * dx, y + t * dy, z + t * dz)
    elif j >= 0 and still.texture[j] != MIRROR:
        mr, mg, mb = _shade(still, moving, False, j, light, s, x + t * dx, y + t * dy, z + t * dz)
    else:
        mr, mg, mb = _sky(dy)
    return r * mr, g * mg, b * mb


@njit(cache=True, parallel=True)
def _trace_frame(camera, light, still, moving, depth, point, ambient, direct, mirror, image):
    height, width, _ = depth.shape
    for row in prange(height):
        for col in range(width):
            red, green, blue = 0.0, 0.0, 0.0
            for s in range(SAMPLES * SAMPLES):
                dx, dy, dz = _ray(camera, row, col, s)
                t, i = _nearest(moving, camera[0, 0], camera[0, 1], camera[0, 2], dx, dy, dz, depth[row, col, s])
                p = point[row, col, s]
                if i >= 0:
                    x, y, z = camera[0, 0] + t * dx, camera[0, 1] + t * dy, camera[0, 2] + t * dz
                    r, g, b = _shade(still, moving, True, i, light, s, x, y, z)
                elif mirror[row, col, s] >= 0:
                    r, g, b = _reflect(still, moving, mirror[row, col, s], light, s, p[0], p[1], p[2], dx, dy, dz)
                else:
                    r, g, b = direct[row, col, s, 0], direct[row, col, s, 1], direct[row, col, s, 2]
                    if r + g + b > 0:
                        sx, sy, sz, distance = _lamp(light, s, p[0], p[1], p[2])
                        if _nearest(moving, p[0], p[1], p[2], sx, sy, sz, distance)[1] >= 0:
                            r, g, b = 0.0, 0.0, 0.0
                    a = ambient[row, col, s]
                    r, g, b = r + a[0], g + a[1], b + a[2]
                red, green, blue = red + r, green + g, blue + b
            image[row, col] = (red, green, blue)


@njit(cache=True, parallel=True)
def _trace_cover(camera, moving, counts, depth, cover, distance):
    height, width, samples = depth.shape
    for row in prange(height):
        for col in range(width):
            for s in range(samples):
                dx, dy, dz = _ray(camera, row, col, s)
                t, i = _nearest(moving, camera[0, 0], camera[0, 1], camera[0, 2], dx, dy, dz, depth[row, col, s])
                if i >= 0 and counts[i]:
                    cover[row, col] += 1 / samples
                forward = dx * camera[3, 0] + dy * camera[3, 1] + dz * camera[3, 2]
                distance[row, col] += t * forward / samples


def _pack(camera: Camera) -> np.ndarray:
    """[6, 3] float64: centre, right, down, forward, (cx, cy, 0), (fx, fy, 0)."""
    viewmat, K = camera.viewmat.astype(np.float64), camera.K.astype(np.float64)
    center = -viewmat[:3, :3].T @ viewmat[:3, 3]
    return np.stack([center, *viewmat[:3, :3], [K[0, 2], K[1, 2], 0], [K[0, 0], K[1, 1], 0]])


def trace_still(camera: Camera, still: Shapes, light: np.ndarray) -> Still:
    """What `camera` sees of the standing solids. light: [3], the lamp's centre."""
    shape = (camera.height, camera.width, SAMPLES * SAMPLES)
    depth, mirror = np.empty(shape, np.float32), np.empty(shape, np.int32)
    point, ambient, direct = (np.zeros((*shape, 3), np.float32) for _ in range(3))
    _trace_still(_pack(camera), *shape[:2], light, still, depth, point, ambient, direct, mirror)
    return Still(depth, point, ambient, direct, mirror)


def trace_frame(camera: Camera, seen: Still, still: Shapes, moving: Shapes, light: np.ndarray) -> np.ndarray:
    """One frame as uint8 [H, W, 3] sRGB."""
    image = np.empty((camera.height, camera.width, 3))
    _trace_frame(_pack(camera), light, still, moving, *seen, image)
    linear = np.clip(image / SAMPLES**2, 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(srgb * 255).astype(np.uint8)


def trace_cover(camera: Camera, seen: Still, moving: Shapes, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(cover, depth), both [H, W] float32: the share of each pixel that the moving solids with counts [N] bool fill, and the mean
    depth along the viewing axis of all that is seen.
    """
    cover, depth = np.zeros((2, camera.height, camera.width))
    _trace_cover(_pack(camera), moving, counts, seen.depth, cover, depth)
    return cover.astype(np.float32), depth.astype(np.float32)
