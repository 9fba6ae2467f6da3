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
SAMPLES = 3
"""Rays along an edge of a pixel."""
FAR = 1e9
EPSILON = 1e-4
LIGHT_SIZE = 0.5


class Shapes(NamedTuple):
    """Solids as arrays, sorted by the body they are part of.

    kind: [N]. position: [N, 3]. rotation: [N, 3, 3] local to world. half: [N, 3] half extents (a cylinder's axis is y).
    texture: [N]. colors: [N, 3, 3], three linear colours a solid. scale, phase: [N], the texture's. occlusion: [N], how strongly
    a solid darkens the ambient light around it. body_first: [B + 1], where each body's solids start. body_center: [B, 3],
    body_radius: [B], a sphere around each body.
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
    body_first: np.ndarray
    body_center: np.ndarray
    body_radius: np.ndarray


class Still(NamedTuple):
    """What one camera sees of the standing solids.

    Per sub-sample, [H, W, S*S]: depth, the distance along the unit ray. point: [..., 3], what is seen, in the mirror where one is
    hit. ambient, direct: [..., 3], light it sends from the surroundings and straight from the lamp. mirror: the mirror hit or -1.
    Per pixel, [H, W]: plain: [..., 3], the mean colour when nothing moves. middle: [..., 3] and spread, a sphere around the points.
    """

    depth: np.ndarray
    point: np.ndarray
    ambient: np.ndarray
    direct: np.ndarray
    mirror: np.ndarray
    plain: np.ndarray
    middle: np.ndarray
    spread: np.ndarray


@njit(cache=True, error_model="numpy")
def _three(array, i):
    """Row i of an [N, 3] array as numbers: a view would cost a reference count shared by all threads."""
    return array[i, 0], array[i, 1], array[i, 2]


@njit(cache=True, error_model="numpy")
def _to_local(shapes, i, x, y, z):
    R = shapes.rotation
    return (
        R[i, 0, 0] * x + R[i, 1, 0] * y + R[i, 2, 0] * z,
        R[i, 0, 1] * x + R[i, 1, 1] * y + R[i, 2, 1] * z,
        R[i, 0, 2] * x + R[i, 1, 2] * y + R[i, 2, 2] * z,
    )


@njit(cache=True, error_model="numpy")
def _slab(o, d, half, low, high):
    """The part [low, high] of a ray's parameter for which |o + t d| <= half, on one axis."""
    if abs(d) < 1e-12:
        return (low, high) if abs(o) <= half else (FAR, -FAR)
    a, b = (-half - o) / d, (half - o) / d
    return max(low, min(a, b)), min(high, max(a, b))


@njit(cache=True, error_model="numpy")
def _hit(shapes, i, ox, oy, oz, dx, dy, dz):
    """Distance along a unit ray to solid i from outside it, or FAR."""
    p, half = _three(shapes.position, i), _three(shapes.half, i)
    ox, oy, oz = _to_local(shapes, i, ox - p[0], oy - p[1], oz - p[2])
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


@njit(cache=True, error_model="numpy")
def _meets(shapes, body, ox, oy, oz, dx, dy, dz, limit, margin, widening):
    """Whether a ray may meet a body's sphere, grown by margin + widening * distance, before `limit`."""
    c = _three(shapes.body_center, body)
    cx, cy, cz = c[0] - ox, c[1] - oy, c[2] - oz
    along = cx * dx + cy * dy + cz * dz
    radius = shapes.body_radius[body] + margin + widening * max(along, 0.0)
    return along > -radius and along - radius < limit and cx * cx + cy * cy + cz * cz - along * along < radius * radius


@njit(cache=True, error_model="numpy")
def _nearest(shapes, ox, oy, oz, dx, dy, dz, limit):
    """(distance, index) of the first solid before `limit`; index -1 if there is none."""
    best, index = limit, -1
    for body in range(len(shapes.body_radius)):
        if _meets(shapes, body, ox, oy, oz, dx, dy, dz, best, 0.0, 0.0):
            for i in range(shapes.body_first[body], shapes.body_first[body + 1]):
                t = _hit(shapes, i, ox, oy, oz, dx, dy, dz)
                if t < best:
                    best, index = t, i
    return best, index


@njit(cache=True, error_model="numpy")
def _blocked(shapes, ox, oy, oz, dx, dy, dz, limit):
    """Whether any solid lies on a ray before `limit`."""
    for body in range(len(shapes.body_radius)):
        if _meets(shapes, body, ox, oy, oz, dx, dy, dz, limit, 0.0, 0.0):
            for i in range(shapes.body_first[body], shapes.body_first[body + 1]):
                if _hit(shapes, i, ox, oy, oz, dx, dy, dz) < limit:
                    return True
    return False


@njit(cache=True, error_model="numpy")
def _normal(shapes, i, x, y, z):
    """Outward unit normal in local coordinates at a local point of the surface."""
    h = _three(shapes.half, i)
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


@njit(cache=True, error_model="numpy")
def _surface(shapes, i, x, y, z):
    """World normal and albedo at a world point on solid i."""
    p, half, R, colors = _three(shapes.position, i), _three(shapes.half, i), shapes.rotation, shapes.colors
    x, y, z = _to_local(shapes, i, x - p[0], y - p[1], z - p[2])
    nx, ny, nz = _normal(shapes, i, x, y, z)
    palette = (
        (colors[i, 0, 0], colors[i, 0, 1], colors[i, 0, 2]),
        (colors[i, 1, 0], colors[i, 1, 1], colors[i, 1, 2]),
        (colors[i, 2, 0], colors[i, 2, 1], colors[i, 2, 2]),
    )
    r, g, b = albedo(shapes.texture[i], x, y, z, nx, ny, nz, half, palette, shapes.scale[i], shapes.phase[i])
    wx = R[i, 0, 0] * nx + R[i, 0, 1] * ny + R[i, 0, 2] * nz
    wy = R[i, 1, 0] * nx + R[i, 1, 1] * ny + R[i, 1, 2] * nz
    wz = R[i, 2, 0] * nx + R[i, 2, 1] * ny + R[i, 2, 2] * nz
    return wx, wy, wz, r, g, b


@njit(cache=True, error_model="numpy")
def _openness(shapes, me, x, y, z, nx, ny, nz):
    """Share of the ambient light that the other solids leave: each counts as the sphere of its extent."""
    light = 1.0
    for i in range(len(shapes.kind)):
        if i != me and shapes.occlusion[i] > 0:
            p, h = _three(shapes.position, i), _three(shapes.half, i)
            cx, cy, cz = p[0] - x, p[1] - y, p[2] - z
            d2 = cx * cx + cy * cy + cz * cz
            r2 = (h[0] * h[1] + h[1] * h[2] + h[2] * h[0]) / 3
            cosine = (cx * nx + cy * ny + cz * nz) / math.sqrt(d2 + 1e-9)
            light *= 1 - shapes.occlusion[i] * max(0.0, min(1.0, 0.35 + 0.65 * cosine)) * r2 / (r2 + d2)
    return light


@njit(cache=True, error_model="numpy")
def _lamp(light, sample, x, y, z):
    """Unit direction and distance from a point to the part of the lamp that this sub-sample sees.

    The parts stand like rooks on the square of the lamp: a shadow edge has as many steps as there are, in either direction.
    """
    n = SAMPLES * SAMPLES
    lx = light[0] + ((sample * 7 % n + 0.5) / n - 0.5) * LIGHT_SIZE - x
    ly = light[1] - y
    lz = light[2] + ((sample * 5 % n + 0.5) / n - 0.5) * LIGHT_SIZE - z
    distance = math.sqrt(lx * lx + ly * ly + lz * lz)
    return lx / distance, ly / distance, lz / distance, distance


@njit(cache=True, error_model="numpy")
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
        power = 0.0 if _blocked(still, x, y, z, sx, sy, sz, distance) else cosine
    return r * ar, g * ag, b * ab, r * power * 1.02, g * power * 0.93, b * power * 0.80


@njit(cache=True, error_model="numpy")
def _shade(still, moving, i, light, sample, x, y, z):
    """Colour leaving moving solid i at a point, with the shadows of everything."""
    ar, ag, ab, r, g, b = _lit(still, moving, i, -1, light, sample, x, y, z)
    if r + g + b > 0:
        sx, sy, sz, distance = _lamp(light, sample, x, y, z)
        if _blocked(moving, x, y, z, sx, sy, sz, distance):
            r, g, b = 0.0, 0.0, 0.0
    return ar + r, ag + g, ab + b


@njit(cache=True, error_model="numpy")
def _ray(camera, row, col, sample):
    """Unit world direction through a sub-sample. camera: [6, 3] as `_pack` makes it."""
    u = (col + (sample % SAMPLES + 0.5) / SAMPLES - camera[4, 0]) / camera[5, 0]
    v = (row + (sample // SAMPLES + 0.5) / SAMPLES - camera[4, 1]) / camera[5, 1]
    x = camera[1, 0] * u + camera[2, 0] * v + camera[3, 0]
    y = camera[1, 1] * u + camera[2, 1] * v + camera[3, 1]
    z = camera[1, 2] * u + camera[2, 2] * v + camera[3, 2]
    norm = math.sqrt(x * x + y * y + z * z)
    return x / norm, y / norm, z / norm


@njit(cache=True, error_model="numpy")
def _sky(dy):
    """What a ray that leaves the room sees, by the height of its direction."""
    up = min(1.0, max(0.0, 0.5 + dy))
    return 0.42 + 0.2 * up, 0.44 + 0.24 * up, 0.46 + 0.32 * up


@njit(cache=True, error_model="numpy")
def _reflect(still, i, x, y, z, dx, dy, dz):
    """Direction after mirror i, and the mirror's tint."""
    nx, ny, nz, r, g, b = _surface(still, i, x, y, z)
    k = 2 * (dx * nx + dy * ny + dz * nz)
    return dx - k * nx, dy - k * ny, dz - k * nz, r, g, b


@njit(cache=True, error_model="numpy")
def _look(still, light, s, ox, oy, oz, dx, dy, dz):
    """(distance, mirror, point, ambient, direct) of what a ray sees of the standing solids; a mirror in a mirror shows the sky."""
    distance, i = _nearest(still, ox, oy, oz, dx, dy, dz, FAR)
    x, y, z = ox + distance * dx, oy + distance * dy, oz + distance * dz
    tr, tg, tb, t, mirror = 1.0, 1.0, 1.0, distance, -1
    if i >= 0 and still.texture[i] == MIRROR:
        mirror = i
        dx, dy, dz, tr, tg, tb = _reflect(still, i, x, y, z, dx, dy, dz)
        ox, oy, oz = x, y, z
        t, i = _nearest(still, x, y, z, dx, dy, dz, FAR)
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
    if i < 0 or still.texture[i] == MIRROR:
        r, g, b = _sky(dy)
        return distance, mirror, (x, y, z), (tr * r, tg * g, tb * b), (0.0, 0.0, 0.0)
    ar, ag, ab, r, g, b = _lit(still, still, i, i, light, s, x, y, z)
    return distance, mirror, (x, y, z), (tr * ar, tg * ag, tb * ab), (tr * r, tg * g, tb * b)


@njit(cache=True, error_model="numpy", parallel=True)
def _trace_still(camera, height, width, light, still, depth, point, ambient, direct, mirror):
    for row in prange(height):
        for col in range(width):
            for s in range(SAMPLES * SAMPLES):
                dx, dy, dz = _ray(camera, row, col, s)
                t, m, p, a, d = _look(still, light, s, camera[0, 0], camera[0, 1], camera[0, 2], dx, dy, dz)
                depth[row, col, s], mirror[row, col, s] = t, m
                point[row, col, s], ambient[row, col, s], direct[row, col, s] = p, a, d


@njit(cache=True, error_model="numpy")
def _unchanged(camera, light, moving, row, col, middle, spread):
    """True only if no moving body can be seen in a pixel or cast a shadow on what is seen there."""
    dx, dy, dz = _ray(camera, row, col, SAMPLES * (SAMPLES // 2) + SAMPLES // 2)
    x, y, z = middle[row, col, 0], middle[row, col, 1], middle[row, col, 2]
    sx, sy, sz = light[0] - x, light[1] - y, light[2] - z
    distance = math.sqrt(sx * sx + sy * sy + sz * sz)
    sx, sy, sz = sx / distance, sy / distance, sz / distance
    widening = 1.2 / min(camera[5, 0], camera[5, 1])
    to_lamp = LIGHT_SIZE * 0.71 / distance
    for body in range(len(moving.body_radius)):
        if _meets(moving, body, camera[0, 0], camera[0, 1], camera[0, 2], dx, dy, dz, FAR, 0.0, widening):
            return False
        if _meets(moving, body, x, y, z, sx, sy, sz, distance, spread[row, col], to_lamp):
            return False
    return True


@njit(cache=True, error_model="numpy")
def _sample(camera, light, still, moving, seen, row, col, s):
    """Colour of one sub-sample, given what it sees of the standing solids."""
    ox, oy, oz = camera[0, 0], camera[0, 1], camera[0, 2]
    dx, dy, dz = _ray(camera, row, col, s)
    depth, mirror = seen.depth[row, col, s], seen.mirror[row, col, s]
    px, py, pz = seen.point[row, col, s, 0], seen.point[row, col, s, 1], seen.point[row, col, s, 2]
    t, i = _nearest(moving, ox, oy, oz, dx, dy, dz, depth)
    tr, tg, tb = 1.0, 1.0, 1.0
    if i < 0 and mirror >= 0:
        ox, oy, oz = ox + depth * dx, oy + depth * dy, oz + depth * dz
        dx, dy, dz, tr, tg, tb = _reflect(still, mirror, ox, oy, oz, dx, dy, dz)
        limit = min(FAR, math.sqrt((px - ox) ** 2 + (py - oy) ** 2 + (pz - oz) ** 2))
        t, i = _nearest(moving, ox, oy, oz, dx, dy, dz, limit)
    if i >= 0:
        r, g, b = _shade(still, moving, i, light, s, ox + t * dx, oy + t * dy, oz + t * dz)
        return tr * r, tg * g, tb * b
    r, g, b = seen.direct[row, col, s, 0], seen.direct[row, col, s, 1], seen.direct[row, col, s, 2]
    if r + g + b > 0:
        sx, sy, sz, distance = _lamp(light, s, px, py, pz)
        if _blocked(moving, px, py, pz, sx, sy, sz, distance):
            r, g, b = 0.0, 0.0, 0.0
    return r + seen.ambient[row, col, s, 0], g + seen.ambient[row, col, s, 1], b + seen.ambient[row, col, s, 2]


@njit(cache=True, error_model="numpy", parallel=True)
def _trace_frame(camera, light, still, moving, seen, image):
    height, width, samples = seen.depth.shape
    for row in prange(height):
        for col in range(width):
            if _unchanged(camera, light, moving, row, col, seen.middle, seen.spread):
                for k in range(3):
                    image[row, col, k] = seen.plain[row, col, k]
                continue
            red, green, blue = 0.0, 0.0, 0.0
            for s in range(samples):
                r, g, b = _sample(camera, light, still, moving, seen, row, col, s)
                red, green, blue = red + r, green + g, blue + b
            image[row, col, 0], image[row, col, 1], image[row, col, 2] = red / samples, green / samples, blue / samples


@njit(cache=True, error_model="numpy", parallel=True)
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
    depth, mirror = np.empty(shape), np.empty(shape, np.int32)
    point, ambient, direct = (np.zeros((*shape, 3), np.float32) for _ in range(3))
    _trace_still(_pack(camera), *shape[:2], light, still, depth, point, ambient, direct, mirror)
    low, high = point.min(2), point.max(2)
    spread = np.linalg.norm(high - low, axis=-1) / 2
    spread[(mirror >= 0).any(2)] = FAR  # what a mirror shows may change wherever it stands
    plain = (ambient.astype(np.float64) + direct).mean(2)
    return Still(depth, point, ambient, direct, mirror, plain, (low + high) / 2, spread)


def trace_frame(camera: Camera, seen: Still, still: Shapes, moving: Shapes, light: np.ndarray) -> np.ndarray:
    """One frame as uint8 [H, W, 3] sRGB."""
    image = np.empty((camera.height, camera.width, 3))
    _trace_frame(_pack(camera), light, still, moving, seen, image)
    linear = np.clip(image, 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(srgb * 255).astype(np.uint8)


def trace_cover(camera: Camera, seen: Still, moving: Shapes, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(cover, depth), both [H, W] float32: the share of each pixel that the moving solids with counts [N] bool fill, and the mean
    depth along the viewing axis of all that is seen.
    """
    cover, depth = np.zeros((2, camera.height, camera.width))
    _trace_cover(_pack(camera), moving, counts, seen.depth, cover, depth)
    return cover.astype(np.float32), depth.astype(np.float32)
