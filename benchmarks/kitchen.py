"""Film and reconstruct `kitchen`: cameras on one side, somebody cooks, and the window shows distant hills.

Eighteen cameras in two rows on a stretch of 2.4 units; what moves is a body's length away, the view from the window five times as far.

python benchmarks/kitchen.py
python benchmarks/kitchen.py --rich --width 1352 --frames 60    as large as Neural 3D Video, and as rich in detail
"""

import math
from pathlib import Path

import numpy as np
import tyro

from film import SKIN, Film
from splatreel.config import Quality
from splatreel.scene.camera import Camera, facing
from toyroom import room as toys
from toyroom import textures as tx
from toyroom.room import Builder, turn_z
from toyroom.solids import BOX, CYLINDER, ELLIPSOID, TEXTURE, Shapes

LIGHT = np.array([-1.0, 3.6, 2.2])
ROWS, COLUMNS = 2, 9
HELD_OUT = ("cam00",)
NOISE, RICH_NOISE, GAIN = 2.0, 3.0, 0.02
STEEL, SHIRT = (0.75, 0.76, 0.78), ((0.25, 0.3, 0.45), (0.85, 0.85, 0.8))
COOK, PAN = np.array([0.1, 0.0, -1.0]), np.array([0.35, 0.95, -0.2])
TOSS = 0.5
"""Seconds that the food is in the air."""


def main(
    quality: Quality = "standard",
    frames: int = 45,
    seed: int = 0,
    width: int = 336,
    rich: bool = False,
    out: Path | None = None,
    note: str = "",
) -> None:
    """Film, reconstruct, evaluate, record. Only the default width with 45 frames is shown in results.md.

    width: of images, pixels. rich: all surfaces have grain, and images more noise.
    """
    other = [str(width)] * (width != 336) + ["rich"] * rich + [f"{frames}-frames"] * (frames != 45)
    film(width, rich).run("-".join(["kitchen", *other]), quality, frames, seed, out, note)


def film(width: int = 336, rich: bool = False) -> Film:
    """Return the film. Images have an aspect ratio of 4:3."""
    cameras = wall(width, round(width * 3 / 4))
    if not rich:
        return Film(cameras, HELD_OUT, standing(), moving, LIGHT, NOISE, GAIN)
    return Film(
        cameras, HELD_OUT, grained(standing()), lambda seconds: grained(moving(seconds)), LIGHT, RICH_NOISE, GAIN
    )


def grained(shapes: Shapes) -> Shapes:
    """Return the same solids with grain on all surfaces."""
    solids = shapes.solids.copy()
    solids[:, TEXTURE] += tx.GRAINED
    return shapes._replace(solids=solids)


def wall(width: int, height: int, columns: int = COLUMNS) -> list[Camera]:
    """Return two uneven rows of cameras that look into the room. The first is in the middle of the lower row.

    columns: two or more, on the same stretch.
    """
    cameras = []
    step = 0.3 * (COLUMNS - 1) / (columns - 1)
    for k in range(ROWS * columns):
        i = (k + columns // 2) % (ROWS * columns)
        row, column = divmod(i, columns)
        x = step * (column - (columns - 1) / 2) + 0.04 * (i * 7 % 3)
        center = np.array([x, 1.35 + 0.45 * row + 0.05 * (i * 5 % 3), 2.6 + 0.08 * (i * 3 % 4)])
        forward = np.array([0.25 * x, 1.15, -3.0]) - center
        cameras.append(facing(f"cam{k:02d}", center, forward / np.linalg.norm(forward), 0.75 * width, width, height))
    return cameras


def standing() -> Shapes:
    b = Builder()
    room(b)
    b.body()
    b.add(BOX, (0, 0.45, -0.3), (1.6, 0.45, 0.5), (toys.WHITE, STEEL), tx.CHECKS, 3.0, 0.2, occlusion=0.3)
    b.add(BOX, (-2.2, 0.9, -2.8), (0.5, 0.9, 0.35), (STEEL,), occlusion=0.3)
    jars = ((-1.2, -0.4, toys.RED), (-0.85, -0.1, toys.TEAL), (1.1, -0.35, toys.YELLOW), (1.35, -0.05, toys.GREEN))
    for x, z, color in jars:
        b.add(CYLINDER, (x, 1.02, z), (0.08, 0.12, 0.08), (color, toys.CREAM), tx.BANDS, 3.0)
    b.body()
    b.add(CYLINDER, tuple(PAN), (0.24, 0.05, 0.24), (toys.BLACK,))
    b.add(BOX, (2.0, 1.6, -3.0), (0.5, 0.35, 0.05), (toys.RED, toys.BLUE, toys.YELLOW), tx.PAINTING)
    for i, color in enumerate((toys.PURPLE, toys.ORANGE, toys.TEAL, toys.PINK, toys.BLUE)):
        half = (0.1, 0.16 + 0.03 * (i % 3), 0.08)
        b.add(BOX, (-2.0 + 0.3 * i, 2.2, -3.0), half, (color, toys.CREAM), tx.STRIPES, 14.0)
    return b.shapes()


def room(b: Builder) -> None:
    """Return a floor, a papered wall with a window, and distant hills."""
    b.body(shadows=False)
    b.add(BOX, (0, -0.5, -3), (9, 0.5, 9), (toys.WOOD, (0.78, 0.56, 0.34)), tx.PLANKS, 2.0, 0.3, occlusion=0)
    paper = ((0.85, 0.83, 0.78), (0.8, 0.78, 0.72), toys.CREAM)
    for (x, y), (wide, high) in (((-3.4, 2), (2.2, 2.2)), ((3.4, 2), (2.2, 2.2)), ((0, 0.5), (1.2, 0.5))):
        b.add(BOX, (x, y, -3.2), (wide, high, 0.1), paper, tx.WALLPAPER, 1.3, 0.1, occlusion=0)
    b.add(BOX, (0, 3.4, -3.2), (1.2, 0.6, 0.1), paper, tx.WALLPAPER, 1.3, 0.4, occlusion=0)
    hills = ((0.5, 0.7, 0.5), (0.4, 0.6, 0.9), toys.WHITE)
    b.add(BOX, (0, 2, -12), (9, 4, 0.1), hills, tx.CHECKS, 0.7, 0.1, occlusion=0)


def moving(seconds: float) -> Shapes:
    b = Builder()
    _cook(b, seconds)
    _food(b, seconds)
    return b.shapes()


def _cook(b: Builder, t: float) -> None:
    """Return the cook, who sways, nods and works with both hands."""
    x, _, z = COOK + np.array([0.06 * math.sin(1.3 * t), 0, 0])
    head = x + 0.02 * math.sin(2 * t)
    b.body()
    b.add(ELLIPSOID, (x, 1.05, z), (0.27, 0.45, 0.17), SHIRT, tx.CHECKS, 9.0)
    b.add(ELLIPSOID, (head, 1.66, z + 0.03), (0.12, 0.16, 0.14), (SKIN, (0.3, 0.2, 0.15)), tx.BANDS, 0.4)
    b.add(ELLIPSOID, (head, 1.76, z - 0.02), (0.13, 0.1, 0.14), ((0.2, 0.13, 0.1),))
    for side in (-1, 1):
        turn = turn_z(side * (0.35 + 0.25 * math.sin(4 * t + side)))
        shoulder = np.array([x + 0.25 * side, 1.35, z + 0.05])
        elbow = shoulder + turn @ (0, -0.34, 0)
        hand = elbow + np.array([0.03 * math.sin(6 * t), 0, 0.3])
        b.add(ELLIPSOID, tuple((shoulder + elbow) / 2), (0.07, 0.2, 0.07), SHIRT, tx.CHECKS, 9.0, turn=turn)
        b.add(ELLIPSOID, tuple((elbow + hand) / 2), (0.05, 0.06, 0.19), (SKIN,))
        b.add(ELLIPSOID, tuple(hand), (0.05, 0.05, 0.06), (SKIN,))


def _food(b: Builder, t: float) -> None:
    """Return a slice that is tossed and turns over, and a flickering flame behind it."""
    u = t % TOSS / TOSS
    food = PAN + np.array([0.03 * math.sin(9 * t), 0.09 + 2 * u * (1 - u), 0])
    b.body()
    colors = ((0.75, 0.4, 0.25), (0.95, 0.85, 0.6))
    b.add(BOX, tuple(food), (0.09, 0.03, 0.07), colors, tx.STRIPES, 20.0, turn=turn_z(6 * t))
    high = 0.6 + 0.4 * math.sin(23 * t) * math.sin(7 * t + 1)
    flame = PAN + np.array([0, 0.06 + 0.1 * high, -0.16])
    b.body(shadows=False)
    b.add(ELLIPSOID, tuple(flame), (0.05, 0.05 + 0.12 * high, 0.05), (toys.YELLOW, toys.ORANGE), tx.BANDS, 0.5)


if __name__ == "__main__":
    tyro.cli(main)
