"""Film and reconstruct `yard`: two runners and a thrown ball outdoors, with few cameras and distant trees.

Twelve cameras on 140 degrees, ten of them to train on; the trees are four to six times as far as the players.

python benchmarks/yard.py
"""

import math
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from film import SKIN, Film
from record import record
from splatreel.config import Quality
from splatreel.scene.camera import Camera, facing
from toyroom import room as toys
from toyroom import textures as tx
from toyroom.room import Builder, turn_x, turn_y, turn_z
from toyroom.solids import BOX, CYLINDER, ELLIPSOID, Shapes

LIGHT = np.array([4.0, 9.0, 6.0])
CAMERAS, TREES = 12, 14
HELD_OUT = ("cam03", "cam08")
NOISE, GAIN = 2.0, 0.03
TROUSERS = ((0.2, 0.2, 0.3), (0.5, 0.45, 0.4))


def main(
    quality: Quality = "standard", frames: int = 40, seed: int = 0, out: Path | None = None, note: str = ""
) -> None:
    """Film, reconstruct, evaluate, record. Images are 400x225."""
    filmed = film()
    reel = filmed.run("yard", quality, frames, seed, out, note)
    record("yard, the ball", {"cameras": filmed.shows(reel, frames, partial(moving, ball=False))}, note)


def film() -> Film:
    return Film(arc(400, 225), HELD_OUT, standing(), moving, LIGHT, NOISE, GAIN)


def arc(width: int, height: int) -> list[Camera]:
    """Return cameras on an arc, at five heights and three distances. Not all of them look at the middle."""
    cameras = []
    for i in range(CAMERAS):
        angle, radius = math.radians(-70 + 140 * i / (CAMERAS - 1)), 5.5 + 0.5 * (i * 5 % 3)
        height_of = 1.3 + 0.5 * (i % 2) + 0.2 * (i % 3)
        center = np.array([radius * math.sin(angle), height_of, radius * math.cos(angle)])
        forward = np.array([0.3 * math.sin(i), 0.9, 0]) - center
        cameras.append(facing(f"cam{i:02d}", center, forward / np.linalg.norm(forward), 0.8 * width, width, height))
    return cameras


def standing() -> Shapes:
    """Return grass, a house, a board, a box and a row of trees."""
    b, rng = Builder(), np.random.default_rng(0)
    b.body(shadows=False)
    b.add(BOX, (0, -0.5, 0), (60, 0.5, 60), ((0.35, 0.5, 0.25), (0.42, 0.58, 0.3)), tx.PLANKS, 0.8, 0.3, occlusion=0)
    b.body()
    house = ((0.8, 0.7, 0.6), (0.7, 0.55, 0.5), toys.WHITE)
    b.add(BOX, (-3, 1.8, -9), (3.5, 1.8, 2), house, tx.CHECKS, 1.2, 0.1)
    b.add(BOX, (6, 1.0, -7), (1.2, 1.0, 0.2), (toys.RED, toys.CREAM, toys.YELLOW), tx.STRIPES, 4.0)
    b.body(shadows=False)
    for k in range(TREES):
        angle, far = -1.3 + 0.2 * k, 22 + 14 * rng.random()
        x, z = far * math.sin(angle), -far * math.cos(angle)
        leaves = ((0.2, 0.42 + 0.1 * rng.random(), 0.18), (0.3, 0.5, 0.2))
        b.add(CYLINDER, (x, 1.5, z), (0.4, 1.5, 0.4), ((0.35, 0.25, 0.15),), occlusion=0)
        b.add(ELLIPSOID, (x, 4.5, z), (2.5, 2.8, 2.5), leaves, tx.CHECKS, 1 + rng.random(), occlusion=0)
    b.body()
    colors = (toys.BLUE, toys.CREAM, toys.YELLOW)
    b.add(BOX, (1.8, 0.4, -1.2), (0.4, 0.4, 0.4), colors, tx.EMBLEM, turn=turn_y(0.4))
    return b.shapes()


def moving(seconds: float, ball: bool = True) -> Shapes:
    b, angle = Builder(), 0.8 * seconds
    red, blue = ((0.75, 0.2, 0.2), toys.WHITE), (toys.BLUE, toys.YELLOW)
    _runner(b, (1.3 * math.cos(angle), 0, 0.9 * math.sin(angle)), -angle, 7 * seconds, red)
    _runner(b, (-1.5 + 0.9 * seconds, 0, -0.8), math.pi / 2, 7 * seconds + 1.2, blue)
    if ball:
        _ball(b, seconds)
    return b.shapes()


def _runner(b: Builder, place: tuple[float, ...], heading: float, phase: float, shirt: tuple[toys.Color, ...]) -> None:
    """Return a runner.

    Args:
        phase: Phase of the stride, radians.
    """
    turn = turn_y(heading)

    def limb(joint: tuple[float, ...], length: float, half: tuple[float, ...], swing: float) -> tuple:
        bent = turn @ turn_x(swing)
        return tuple(place + turn @ np.array(joint) + bent @ np.array([0, -length, 0])), half, bent

    b.body()
    b.add(ELLIPSOID, tuple(place + np.array([0, 1.2, 0])), (0.24, 0.36, 0.15), shirt, tx.STRIPES, 14.0, turn=turn)
    head = tuple(place + np.array([0, 1.72, 0]))
    b.add(ELLIPSOID, head, (0.12, 0.16, 0.14), (SKIN, (0.25, 0.15, 0.1)), tx.BANDS, 0.4, turn=turn)
    for side in (-1, 1):
        swing = 0.7 * side * math.sin(phase)
        at, half, bent = limb((0.12 * side, 0.88, 0), 0.42, (0.085, 0.45, 0.09), swing)
        b.add(ELLIPSOID, at, half, TROUSERS, tx.BANDS, 2.0, turn=bent)
        at, half, bent = limb((0.3 * side, 1.45, 0), 0.3, (0.06, 0.32, 0.06), -swing)
        b.add(ELLIPSOID, at, half, (shirt[0], SKIN), tx.STRIPES, 8.0, turn=bent)


def _ball(b: Builder, t: float) -> None:
    """Return the ball, which is thrown anew every second."""
    u = t % 1.0
    b.body()
    place = (-1.5 + 3 * u, 0.9 + 4.1 * u - 4.9 * u * u, 0.3)
    b.add(ELLIPSOID, place, (0.14,) * 3, (toys.WHITE, toys.BLACK), tx.SECTORS, 3.0, turn=turn_z(-5 * t))


if __name__ == "__main__":
    tyro.cli(main)
