"""Film and reconstruct `hearth`: fire, steam, poured water, a changing screen and a person who walks through.

The cameras are those of kitchen. Flames add light, steam takes it away: both are fogs whose depth along a ray is computed, not splats
that are laid over each other.

python benchmarks/hearth.py
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import kitchen
from film import SKIN, Film
from splatreel.config import Quality
from splatreel.scene.camera import Camera
from toyroom import room as toys
from toyroom import textures as tx
from toyroom.raytracer import DEPTH, StaticView
from toyroom.room import Builder, turn_z
from toyroom.solids import BOX, CYLINDER, ELLIPSOID, Shapes

HELD_OUT = ("cam00", "cam12")
FIRE, KETTLE, SPOUT = np.array([-1.25, 0.55, -1.2]), np.array([0.55, 1.02, -0.35]), np.array([-0.25, 1.62, -0.3])
SLIDES = (
    ((toys.BLUE, toys.YELLOW), tx.DOTS, 4.0),
    ((toys.RED, toys.WHITE), tx.STRIPES, 16.0),
    ((toys.GREEN, toys.CREAM, toys.PURPLE), tx.PAINTING, 1.0),
    ((toys.PINK, toys.BLACK), tx.CHECKS, 12.0),
)
SLIDE = 13 / 30
"""Seconds that a slide is on the screen."""
FLAMES, PUFFS, DROPS = 40, 14, 14
FLAME, PUFF = 0.45, 1.2
"""Seconds that one of them lives."""
WHITE = np.array([0.75, 0.76, 0.78])


@dataclass(frozen=True)
class Fog:
    """Gaussian in space, with a standard deviation of `size`. light: linear, added at its middle per unit of path; depth: optical,
    for each unit of way, which turns what is behind it white."""

    center: np.ndarray
    size: float
    light: np.ndarray
    depth: float


class FogFilm(Film):
    """A film with flames and steam."""

    def image(self, camera: Camera, seen: StaticView, seconds: float) -> np.ndarray:
        center, rays = _rays(camera)
        behind = seen.samples[..., DEPTH].mean(2)
        light, depth = np.zeros((*behind.shape, 3)), np.zeros(behind.shape)
        for fog in fogs(seconds):
            away = fog.center - center
            along = rays @ away
            way = (
                np.exp((along**2 - away @ away) / (2 * fog.size**2))
                * fog.size
                * math.sqrt(2 * math.pi)
                * (along < behind)
            )
            light += way[..., None] * fog.light
            depth += way * fog.depth
        solid = super().image(camera, seen, seconds) / 255
        linear = np.where(solid <= 0.04045, solid / 12.92, ((solid + 0.055) / 1.055) ** 2.4)
        clear = np.exp(-depth)[..., None]
        linear = (linear * clear + WHITE * (1 - clear) + light).clip(0, 1)
        return 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def main(
    quality: Quality = "standard", frames: int = 45, seed: int = 0, out: Path | None = None, note: str = ""
) -> None:
    """Film, reconstruct, evaluate, record. Images are 336x252."""
    film().run("hearth", quality, frames, seed, out, note)


def film() -> Film:
    cameras = kitchen.wall(336, 252)
    return FogFilm(cameras, HELD_OUT, standing(), moving, kitchen.LIGHT, kitchen.NOISE, kitchen.GAIN)


def fogs(seconds: float) -> list[Fog]:
    """Return flames that rise, shrink and redden, and steam that rises and spreads."""
    found = []
    for k in range(FLAMES):
        wide, deep, late, speed, turn = np.random.default_rng((5, k)).normal(0, 1, 5)
        lives, age = divmod(seconds / FLAME + late, 1.0)
        jumps = np.sin((12.9898 * (lives + 1) + turn, 78.233 * (lives + 1) + turn))
        x = 0.1 * wide * (1 - 0.6 * age) + 0.05 * jumps[0] + 0.03 * age * math.sin((14 + 3 * speed) * seconds + turn)
        z = 0.08 * deep * (1 - 0.6 * age) + 0.03 * jumps[1]
        color = np.array([1.6, 1.0, 0.3]) * (1 - age) + np.array([1.0, 0.15, 0.02]) * age
        strength = 4.5 * math.sin(math.pi * min(1.0, age + 0.08))
        found.append(Fog(FIRE + np.array([x, 0.75 * age, z]), 0.065 - 0.03 * age, strength * color, 0.0))
    for k in range(PUFFS):
        wide, deep, late, speed, turn = np.random.default_rng((6, k)).normal(0, 1, 5)
        age = (seconds / PUFF + late) % 1.0
        x = 0.1 * wide * age + 0.04 * age * math.sin((3.5 + speed) * seconds + turn)
        place = KETTLE + np.array([x, 0.15 + 0.7 * age, 0.1 * deep * age])
        found.append(Fog(place, 0.04 + 0.07 * age, np.zeros(3), 5 * (1 - age) * min(1.0, 6 * age)))
    return found


def standing() -> Shapes:
    b = Builder()
    kitchen.room(b)
    b.body()
    b.add(BOX, (0, 0.45, -0.3), (0.9, 0.45, 0.5), (toys.WHITE, kitchen.STEEL), tx.CHECKS, 3.0, 0.2, occlusion=0.3)
    bricks = ((0.4, 0.25, 0.2), (0.6, 0.5, 0.45))
    b.add(BOX, (FIRE[0], 0.2, FIRE[2]), (0.4, 0.2, 0.3), bricks, tx.STRIPES, 20.0, occlusion=0.3)
    for k in range(4):
        b.add(
            CYLINDER,
            (FIRE[0] - 0.2 + 0.13 * k, 0.45, FIRE[2]),
            (0.05, 0.05, 0.2),
            (toys.BLACK, toys.WOOD),
            tx.BANDS,
            0.5,
        )
    b.body()
    b.add(ELLIPSOID, tuple(KETTLE), (0.14, 0.13, 0.14), (kitchen.STEEL,))
    b.add(CYLINDER, (SPOUT[0], 0.99, SPOUT[2]), (0.12, 0.09, 0.12), (toys.TEAL, toys.CREAM), tx.BANDS, 0.6)
    b.add(BOX, (1.6, 1.5, -2.6), (0.75, 0.5, 0.04), (toys.BLACK,))
    return b.shapes()


def moving(seconds: float) -> Shapes:
    b = Builder()
    b.body(shadows=False)
    colors, texture, scale = SLIDES[int(seconds / SLIDE + 1e-6) % len(SLIDES)]
    b.add(BOX, (1.6, 1.5, -2.55), (0.7, 0.45, 0.02), colors, texture, scale, 3.0 * seconds)
    _walker(b, seconds)
    b.body()
    tilt = turn_z(-0.5 + 0.1 * math.sin(5 * seconds))
    b.add(
        ELLIPSOID,
        (SPOUT[0] - 0.16, SPOUT[1] + 0.1, SPOUT[2]),
        (0.13, 0.1, 0.1),
        (toys.RED, toys.CREAM),
        tx.BANDS,
        0.3,
        turn=tilt,
    )
    for k in range(DROPS if seconds > 0.3 else 0):
        age = (2.2 * seconds + k / DROPS) % 1.0
        drop = SPOUT[0], SPOUT[1] - 0.52 * age**2, SPOUT[2] + 0.006 * math.sin(40 * age + 9 * seconds)
        b.add(ELLIPSOID, drop, (0.016, 0.03, 0.016), ((0.6, 0.8, 0.95),))
    return b.shapes()


def _walker(b: Builder, seconds: float) -> None:
    """Return the person, who walks behind the table from right to left."""
    x, swing = 2.6 - 2.2 * seconds, math.sin(9 * seconds)
    shirt = ((0.6, 0.2, 0.25), toys.CREAM)
    b.body()
    b.add(ELLIPSOID, (x, 1.15, -1.6), (0.26, 0.4, 0.17), shirt, tx.STRIPES, 22.0)
    b.add(ELLIPSOID, (x, 1.7, -1.58), (0.12, 0.16, 0.14), (SKIN, (0.3, 0.2, 0.15)), tx.BANDS, 0.4)
    for side in (-1, 1):
        leg, arm = turn_z(0.5 * side * swing), turn_z(-0.6 * side * swing)
        b.add(
            ELLIPSOID,
            (x + 0.2 * side * swing, 0.45, -1.6 + 0.1 * side),
            (0.1, 0.42, 0.1),
            ((0.2, 0.25, 0.4),),
            turn=leg,
        )
        place = x - 0.2 * side * swing, 1.15, -1.6 + 0.25 * side
        b.add(ELLIPSOID, place, (0.07, 0.32, 0.07), shirt, tx.STRIPES, 22.0, turn=arm)


def _rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera center, [3], and unit directions through the middles of its pixels, [H, W, 3]."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    pixels = np.stack([u, v, np.ones_like(u)], -1)
    rays = pixels @ np.linalg.inv(camera.K).T @ camera.viewmat[:3, :3]
    return camera.center, rays / np.linalg.norm(rays, axis=-1, keepdims=True)


if __name__ == "__main__":
    tyro.cli(main)
