"""Ray tracer of the built-in capture: matte and mirroring solids under one soft light.

It shares no code with splatting, so that reconstructions are judged against an independent renderer. Static solids are
traced once per camera. A frame traces only rays and shadow rays that may hit moving solids. Kernels run on one thread
without the interpreter lock, and cameras are traced in parallel. World and camera conventions are those of
`scene.camera`; lengths are world units, colors linear 0..1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from splatreel.scene.camera import Camera
from toyroom.solids import (
    FAR,
    HALF,
    OCCLUSION,
    POSITION,
    TEXTURE,
    Shapes,
    blocked,
    meets,
    nearest,
    surface,
    three,
)
from toyroom.textures import MIRROR

SAMPLES = 3
"""Rays per pixel edge."""
LIGHT_SIZE = 0.5

# Columns of StaticView.samples and StaticView.pixels.
DEPTH, MIRRORED, POINT, AMBIENT, DIRECT, SAMPLE_COLUMNS = 0, 1, 2, 5, 8, 11
PLAIN, MIDDLE, SPREAD, PIXEL_COLUMNS = 0, 3, 6, 7


class StaticView(NamedTuple):
    """View of the static solids from one camera.

    Attributes:
        samples: [H, W, S * S, 11] float32. DEPTH: distance along the unit ray. MIRRORED: index of the hit mirror or -1.
            POINT [3]: visible point, behind a mirror if one is hit. AMBIENT [3] and DIRECT [3]: its light from the
            surroundings and from the lamp.
        pixels: [H, W, 7] float64. PLAIN [3]: color without motion. MIDDLE [3] and SPREAD: bounding sphere of the
            visible points.
    """

    samples: np.ndarray
    pixels: np.ndarray


@njit(cache=True, error_model="numpy")
def _openness(shapes, me, x, y, z, nx, ny, nz):
    """Return the share of ambient light that the other solids leave; each counts as the sphere of its extent."""
    light = 1.0
    for i in range(len(shapes.solids)):
        if i != me and shapes.solids[i, OCCLUSION] > 0:
            p, h = three(shapes.solids, i, POSITION), three(shapes.solids, i, HALF)
            cx, cy, cz = p[0] - x, p[1] - y, p[2] - z
            d2 = cx * cx + cy * cy + cz * cz
            r2 = (h[0] * h[1] + h[1] * h[2] + h[2] * h[0]) / 3
            cosine = (cx * nx + cy * ny + cz * nz) / math.sqrt(d2 + 1e-9)
            light *= 1 - shapes.solids[i, OCCLUSION] * max(0.0, min(1.0, 0.35 + 0.65 * cosine)) * r2 / (r2 + d2)
    return light


@njit(cache=True, error_model="numpy")
def _lamp(light, sample, x, y, z):
    """Return the unit direction and distance from a point to the part of the lamp that a sub-sample uses.

    The parts form a rook pattern on the lamp's square, which gives shadow edges the most steps in both directions.
    """
    n = SAMPLES * SAMPLES
    lx = light[0] + ((sample * 7 % n + 0.5) / n - 0.5) * LIGHT_SIZE - x
    ly = light[1] - y
    lz = light[2] + ((sample * 5 % n + 0.5) / n - 0.5) * LIGHT_SIZE - z
    distance = math.sqrt(lx * lx + ly * ly + lz * lz)
    return lx / distance, ly / distance, lz / distance, distance


@njit(cache=True, error_model="numpy")
def _lit(still, shapes, i, me, light, sample, x, y, z):
    """Return ambient rgb and direct rgb leaving solid i of `shapes` at a point. Only `still` casts shadows and occludes.

    `me` is the solid's index among the static ones, which it does not occlude, or -1.
    """
    nx, ny, nz, r, g, b = surface(shapes, i, x, y, z)
    open_sky = _openness(still, me, x, y, z, nx, ny, nz)
    up = 0.5 + 0.5 * ny
    ar, ag, ab = open_sky * (0.30 + 0.16 * up), open_sky * (0.27 + 0.21 * up), open_sky * (0.25 + 0.27 * up)
    sx, sy, sz, distance = _lamp(light, sample, x, y, z)
    cosine = nx * sx + ny * sy + nz * sz
    power = 0.0
    if cosine > 0:
        power = 0.0 if blocked(still, x, y, z, sx, sy, sz, distance) else cosine
    return r * ar, g * ag, b * ab, r * power * 1.02, g * power * 0.93, b * power * 0.80


@njit(cache=True, error_model="numpy")
def _shade(still, moving, i, light, sample, x, y, z):
    """Return the color leaving moving solid i at a point, with all shadows."""
    ar, ag, ab, r, g, b = _lit(still, moving, i, -1, light, sample, x, y, z)
    if r + g + b > 0:
        sx, sy, sz, distance = _lamp(light, sample, x, y, z)
        if blocked(moving, x, y, z, sx, sy, sz, distance):
            r, g, b = 0.0, 0.0, 0.0
    return ar + r, ag + g, ab + b


@njit(cache=True, error_model="numpy")
def _ray(camera, row, col, sample):
    """Return the unit world direction through a sub-sample. camera [6, 3] comes from `_pack`."""
    u = (col + (sample % SAMPLES + 0.5) / SAMPLES - camera[4, 0]) / camera[5, 0]
    v = (row + (sample // SAMPLES + 0.5) / SAMPLES - camera[4, 1]) / camera[5, 1]
    x = camera[1, 0] * u + camera[2, 0] * v + camera[3, 0]
    y = camera[1, 1] * u + camera[2, 1] * v + camera[3, 1]
    z = camera[1, 2] * u + camera[2, 2] * v + camera[3, 2]
    norm = math.sqrt(x * x + y * y + z * z)
    return x / norm, y / norm, z / norm


@njit(cache=True, error_model="numpy")
def _sky(dy):
    """Return the color of a ray that leaves the room, by the height of its direction."""
    up = min(1.0, max(0.0, 0.5 + dy))
    return 0.42 + 0.2 * up, 0.44 + 0.24 * up, 0.46 + 0.32 * up


@njit(cache=True, error_model="numpy")
def _reflect(still, i, x, y, z, dx, dy, dz):
    """Return the direction after mirror i, and the mirror's tint."""
    nx, ny, nz, r, g, b = surface(still, i, x, y, z)
    k = 2 * (dx * nx + dy * ny + dz * nz)
    return dx - k * nx, dy - k * ny, dz - k * nz, r, g, b


@njit(cache=True, error_model="numpy")
def _look(still, light, s, ox, oy, oz, dx, dy, dz):
    """Return distance, mirror, point, ambient and direct light of a ray among static solids. A mirror in a mirror shows the sky."""
    distance, i = nearest(still, ox, oy, oz, dx, dy, dz, FAR)
    x, y, z = ox + distance * dx, oy + distance * dy, oz + distance * dz
    tr, tg, tb, t, mirror = 1.0, 1.0, 1.0, distance, -1
    if i >= 0 and still.solids[i, TEXTURE] == MIRROR:
        mirror = i
        dx, dy, dz, tr, tg, tb = _reflect(still, i, x, y, z, dx, dy, dz)
        ox, oy, oz = x, y, z
        t, i = nearest(still, x, y, z, dx, dy, dz, FAR)
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
    if i < 0 or still.solids[i, TEXTURE] == MIRROR:
        r, g, b = _sky(dy)
        return distance, mirror, (x, y, z), (tr * r, tg * g, tb * b), (0.0, 0.0, 0.0)
    ar, ag, ab, r, g, b = _lit(still, still, i, i, light, s, x, y, z)
    return distance, mirror, (x, y, z), (tr * ar, tg * ag, tb * ab), (tr * r, tg * g, tb * b)


@njit(cache=True, error_model="numpy", nogil=True)
def _trace_static(camera, light, still, samples):
    height, width, count, _ = samples.shape
    for row in range(height):
        for col in range(width):
            for s in range(count):
                dx, dy, dz = _ray(camera, row, col, s)
                t, m, p, a, d = _look(still, light, s, camera[0, 0], camera[0, 1], camera[0, 2], dx, dy, dz)
                samples[row, col, s, DEPTH], samples[row, col, s, MIRRORED] = t, m
                for k in range(3):
                    samples[row, col, s, POINT + k] = p[k]
                    samples[row, col, s, AMBIENT + k] = a[k]
                    samples[row, col, s, DIRECT + k] = d[k]


@njit(cache=True, error_model="numpy")
def _unchanged(camera, light, moving, pixels, row, col):
    """Return True only if no moving body can appear in a pixel or cast a shadow on its visible points."""
    dx, dy, dz = _ray(camera, row, col, SAMPLES * (SAMPLES // 2) + SAMPLES // 2)
    x, y, z = pixels[row, col, MIDDLE], pixels[row, col, MIDDLE + 1], pixels[row, col, MIDDLE + 2]
    sx, sy, sz = light[0] - x, light[1] - y, light[2] - z
    distance = math.sqrt(sx * sx + sy * sy + sz * sz)
    sx, sy, sz = sx / distance, sy / distance, sz / distance
    widening = 1.2 / min(camera[5, 0], camera[5, 1])
    to_lamp = LIGHT_SIZE * 0.71 / distance
    for body in range(len(moving.bodies)):
        if meets(moving, body, camera[0, 0], camera[0, 1], camera[0, 2], dx, dy, dz, FAR, 0.0, widening):
            return False
        if meets(moving, body, x, y, z, sx, sy, sz, distance, pixels[row, col, SPREAD], to_lamp):
            return False
    return True


@njit(cache=True, error_model="numpy")
def _sample(camera, light, still, moving, samples, row, col, s):
    """Return the color of one sub-sample, given its view of the static solids."""
    ox, oy, oz = camera[0, 0], camera[0, 1], camera[0, 2]
    dx, dy, dz = _ray(camera, row, col, s)
    depth, mirror = samples[row, col, s, DEPTH], int(samples[row, col, s, MIRRORED])
    px, py, pz = samples[row, col, s, POINT], samples[row, col, s, POINT + 1], samples[row, col, s, POINT + 2]
    t, i = nearest(moving, ox, oy, oz, dx, dy, dz, depth)
    tr, tg, tb = 1.0, 1.0, 1.0
    if i < 0 and mirror >= 0:
        ox, oy, oz = ox + depth * dx, oy + depth * dy, oz + depth * dz
        dx, dy, dz, tr, tg, tb = _reflect(still, mirror, ox, oy, oz, dx, dy, dz)
        limit = min(FAR, math.sqrt((px - ox) ** 2 + (py - oy) ** 2 + (pz - oz) ** 2))
        t, i = nearest(moving, ox, oy, oz, dx, dy, dz, limit)
    if i >= 0:
        r, g, b = _shade(still, moving, i, light, s, ox + t * dx, oy + t * dy, oz + t * dz)
        return tr * r, tg * g, tb * b
    r, g, b = samples[row, col, s, DIRECT], samples[row, col, s, DIRECT + 1], samples[row, col, s, DIRECT + 2]
    if r + g + b > 0:
        sx, sy, sz, distance = _lamp(light, s, px, py, pz)
        if blocked(moving, px, py, pz, sx, sy, sz, distance):
            r, g, b = 0.0, 0.0, 0.0
    ar, ag, ab = samples[row, col, s, AMBIENT], samples[row, col, s, AMBIENT + 1], samples[row, col, s, AMBIENT + 2]
    return r + ar, g + ag, b + ab


@njit(cache=True, error_model="numpy", nogil=True)
def _trace_frame(camera, light, still, moving, samples, pixels, image):
    height, width, count, _ = samples.shape
    for row in range(height):
        for col in range(width):
            if _unchanged(camera, light, moving, pixels, row, col):
                for k in range(3):
                    image[row, col, k] = pixels[row, col, PLAIN + k]
                continue
            red, green, blue = 0.0, 0.0, 0.0
            for s in range(count):
                r, g, b = _sample(camera, light, still, moving, samples, row, col, s)
                red, green, blue = red + r, green + g, blue + b
            image[row, col, 0], image[row, col, 1], image[row, col, 2] = red / count, green / count, blue / count


@njit(cache=True, error_model="numpy", nogil=True)
def _trace_cover(camera, moving, counts, samples, cover, distance):
    height, width, count, _ = samples.shape
    for row in range(height):
        for col in range(width):
            for s in range(count):
                dx, dy, dz = _ray(camera, row, col, s)
                depth = samples[row, col, s, DEPTH]
                t, i = nearest(moving, camera[0, 0], camera[0, 1], camera[0, 2], dx, dy, dz, depth)
                if i >= 0 and counts[i]:
                    cover[row, col] += 1 / count
                forward = dx * camera[3, 0] + dy * camera[3, 1] + dz * camera[3, 2]
                distance[row, col] += t * forward / count


def _pack(camera: Camera) -> np.ndarray:
    """Return a camera as [6, 3] float64: center, right, down, forward, (cx, cy, 0), (fx, fy, 0)."""
    viewmat, K = camera.viewmat.astype(np.float64), camera.K.astype(np.float64)
    center = -viewmat[:3, :3].T @ viewmat[:3, 3]
    return np.stack([center, *viewmat[:3, :3], [K[0, 2], K[1, 2], 0], [K[0, 0], K[1, 1], 0]])


def trace_static(camera: Camera, still: Shapes, light: np.ndarray) -> StaticView:
    """Trace the static solids from a camera. `light` [3] is the lamp's center."""
    samples = np.empty((camera.height, camera.width, SAMPLES * SAMPLES, SAMPLE_COLUMNS), np.float32)
    _trace_static(_pack(camera), light, still, samples)
    points = samples[..., POINT : POINT + 3].astype(np.float64)
    low, high = points.min(2), points.max(2)
    pixels = np.empty((camera.height, camera.width, PIXEL_COLUMNS))
    pixels[..., PLAIN : PLAIN + 3] = (samples[..., AMBIENT : AMBIENT + 3] + samples[..., DIRECT : DIRECT + 3]).mean(2)
    pixels[..., MIDDLE : MIDDLE + 3] = (low + high) / 2
    pixels[..., SPREAD] = np.linalg.norm(high - low, axis=-1) / 2
    pixels[(samples[..., MIRRORED] >= 0).any(2), SPREAD] = FAR  # the content of a mirror may change anywhere
    return StaticView(samples, pixels)


def trace_frame(camera: Camera, seen: StaticView, still: Shapes, moving: Shapes, light: np.ndarray) -> np.ndarray:
    """Return one frame as uint8 [H, W, 3] sRGB."""
    image = np.empty((camera.height, camera.width, 3))
    _trace_frame(_pack(camera), light, still, moving, *seen, image)
    linear = np.clip(image, 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(srgb * 255).astype(np.uint8)


def trace_cover(camera: Camera, seen: StaticView, moving: Shapes, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return coverage and depth, both [H, W] float32.

    Coverage is the share of each pixel that moving solids with counts [N] bool fill. Depth is the mean along the
    viewing axis.
    """
    cover, depth = np.zeros((2, camera.height, camera.width))
    _trace_cover(_pack(camera), moving, counts, seen.samples, cover, depth)
    return cover.astype(np.float32), depth.astype(np.float32)
