"""Film and reconstruct `dominoes`: small falling dominoes, a waving figure and a thrown ball before repeated wallpaper.

Eighteen cameras in a ring, each with its own colors and noise; small dominoes fall within a second (the paper's own failure case),
a figure waves, a ball is thrown across; the wallpaper looks the same everywhere.

python benchmarks/dominoes.py
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
from toyroom.room import Builder, turn_y, turn_z
from toyroom.solids import BOX, ELLIPSOID, Shapes

LIGHT = np.array([0.8, 5.5, 1.2])
CAMERAS, DOMINOES = 18, 14
HELD_OUT = ("cam04", "cam11")
NOISE, GAIN = 3.0, 0.04
"""Standard deviations: of the pixels, in gray levels; of the logarithm of the training cameras' color gains."""


def main(
    quality: Quality = "standard", frames: int = 45, seed: int = 0, out: Path | None = None, note: str = ""
) -> None:
    """Film, reconstruct, evaluate, record. Images are 320x180."""
    filmed = film()
    reel = filmed.run("dominoes", quality, frames, seed, out, note)
    record("dominoes, the ball", {"cameras": filmed.shows(reel, frames, partial(moving, ball=False))}, note)


def film() -> Film:
    return Film(ring(320, 180), HELD_OUT, standing(), moving, LIGHT, NOISE, GAIN)


def ring(width: int, height: int) -> list[Camera]:
    """Return cameras all around, at four heights, that look at the table."""
    cameras = []
    for i in range(CAMERAS):
        angle = 2 * math.pi * i / CAMERAS
        center = np.array([4.6 * math.sin(angle), 1.5 + 0.9 * (i % 2) + 0.2 * (i % 3), 4.6 * math.cos(angle)])
        forward = np.array([0, 0.7, -0.2]) - center
        forward /= np.linalg.norm(forward)
        cameras.append(facing(f"cam{i:02d}", center, forward, 0.95 * width, width, height))
    return cameras


def standing() -> Shapes:
    """Return a papered room, a table and five boxes."""
    b = Builder()
    b.body(shadows=False)
    b.add(BOX, (0, -0.5, 0), (7.2, 0.5, 7.2), (toys.WOOD, (0.78, 0.56, 0.34)), tx.PLANKS, 2.0, 0.3, occlusion=0)
    paper = ((0.55, 0.73, 0.72), (0.66, 0.81, 0.77), toys.CREAM)
    for side in (-1, 1):
        b.add(BOX, (0, 2, 7.2 * side), (7.2, 2.6, 0.2), paper, tx.WALLPAPER, 1.3, 0.1, occlusion=0)
        b.add(BOX, (7.2 * side, 2, 0), (0.2, 2.6, 7.2), paper, tx.WALLPAPER, 1.3, 0.6, occlusion=0)
    b.add(BOX, (0, 0.2, 0), (1.3, 0.2, 0.8), (toys.CREAM, toys.BLUE), tx.CHECKS, 6.0, 0.2, occlusion=0.2)
    places = ((-2.5, -2.0), (2.6, -1.8), (2.2, 2.4), (-2.4, 2.1), (0.0, -3.0))
    colors = (toys.RED, toys.TEAL, toys.PURPLE, toys.GREEN, toys.ORANGE)
    for i, ((x, z), color) in enumerate(zip(places, colors, strict=True)):
        b.body()
        b.add(BOX, (x, 0.45, z), (0.35, 0.45, 0.3), (color, toys.CREAM, toys.YELLOW), tx.EMBLEM, turn=turn_y(0.5 * i))
    return b.shapes()


def moving(seconds: float, ball: bool = True) -> Shapes:
    b = Builder()
    _dominoes(b, seconds)
    _figure(b, seconds)
    if ball:
        _ball(b, seconds)
    return b.shapes()


def _dominoes(b: Builder, t: float) -> None:
    """Return the dominoes. From 0.25 s on, one falls every twentieth of a second, in 0.16 s."""
    colors = (toys.RED, toys.YELLOW, toys.WHITE, toys.BLUE, toys.GREEN)
    for i in range(DOMINOES):
        lean = 1.15 * min(max((t - 0.25 - 0.05 * i) / 0.16, 0.0), 1.0) ** 1.7
        turn, half = turn_z(-lean), (0.025, 0.17, 0.085)
        place = np.array([-1.0 + 0.155 * i, 0.4, 0.35]) + turn @ (0, half[1], 0)
        b.body()
        b.add(BOX, tuple(place), half, (colors[i % 5], toys.BLACK), tx.DOTS, 9.0, turn=turn, occlusion=0.1)


def _figure(b: Builder, t: float) -> None:
    """Return the figure, which sways and swings its arms."""
    x, z, sway = -0.2, -1.5, 0.06 * math.sin(3 * t)
    b.body()
    b.add(ELLIPSOID, (x + sway, 1.0, z), (0.22, 0.42, 0.15), (toys.PURPLE, toys.PINK), tx.STRIPES, 20.0)
    b.add(ELLIPSOID, (x + 1.6 * sway, 1.58, z), (0.13, 0.16, 0.14), (SKIN, (0.3, 0.2, 0.15)), tx.BANDS, 0.4)
    for side in (-1, 1):
        b.add(BOX, (x + 0.1 * side, 0.35, z), (0.08, 0.35, 0.08), (toys.BLUE,))
        turn = turn_z(side * (0.7 + 0.9 * math.sin(5 * t + side)))
        place = np.array([x + sway + 0.22 * side, 1.25, z]) + turn @ (0, -0.3, 0)
        b.add(ELLIPSOID, tuple(place), (0.06, 0.33, 0.06), (toys.PURPLE, SKIN), tx.STRIPES, 12.0, turn=turn)


def _ball(b: Builder, t: float) -> None:
    """Return the ball: it rests for half a second, flies across and hops."""
    u = max(t - 0.5, 0.0)
    x, y = -2.4 + 3.6 * u, 1.3 + 3.2 * u - 4.9 * u * u
    if y < 0.14:
        y = 0.14 + 0.15 * abs(math.sin(6 * u))
    b.body()
    colors = (toys.ORANGE, toys.BLACK, toys.WHITE)
    b.add(ELLIPSOID, (x, y, 0.9), (0.13,) * 3, colors, tx.SECTORS, 3.0, turn=turn_z(-7 * u))


if __name__ == "__main__":
    tyro.cli(main)
