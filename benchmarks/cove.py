"""Film and reconstruct `cove`: a dancer in a white cove, with cameras all around.

Volumetric studios look so. Twenty-four cameras stand upright in a ring, twenty of them to train on; the walls are white as the floor
is, with a strip of sky above them. A skirt of ten flaps flies up and down as she turns.

python benchmarks/cove.py
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
from toyroom.room import Builder, turn_x, turn_y, turn_z
from toyroom.solids import BOX, ELLIPSOID, Shapes

LIGHT = np.array([0.5, 6.0, 1.0])
CAMERAS, WALLS, FLAPS = 24, 16, 10
HELD_OUT = ("cam02", "cam09", "cam16", "cam21")
NOISE, GAIN = 2.0, 0.03
WHITE = (0.85, 0.85, 0.86)


def main(
    quality: Quality = "standard", frames: int = 45, seed: int = 0, out: Path | None = None, note: str = ""
) -> None:
    """Film, reconstruct, evaluate, record. Images are 288x384."""
    film().run("cove", quality, frames, seed, out, note)


def film() -> Film:
    return Film(ring(288, 384), HELD_OUT, standing(), moving, LIGHT, NOISE, GAIN)


def ring(width: int, height: int) -> list[Camera]:
    """Return upright cameras all around, at three heights."""
    cameras = []
    for i in range(CAMERAS):
        angle = 2 * math.pi * i / CAMERAS
        center = np.array([3.6 * math.sin(angle), (0.5, 1.3, 2.3)[i % 3], 3.6 * math.cos(angle)])
        forward = np.array([0, 1.0, 0]) - center
        cameras.append(facing(f"cam{i:02d}", center, forward / np.linalg.norm(forward), 1.25 * width, width, height))
    return cameras


def standing() -> Shapes:
    """Return a white floor with white walls around it."""
    b = Builder()
    b.body(shadows=False)
    b.add(BOX, (0, -0.5, 0), (9, 0.5, 9), (WHITE,), occlusion=0)
    for k in range(WALLS):
        angle = 2 * math.pi * k / WALLS
        place = (8 * math.sin(angle), 3, 8 * math.cos(angle))
        b.add(BOX, place, (1.7, 5, 0.1), (WHITE,), turn=turn_y(angle), occlusion=0)
    return b.shapes()


def moving(t: float) -> Shapes:
    """Return the dancer: she turns faster and faster, hops, swings her legs and lifts her arms."""
    b, turn = Builder(), turn_y(2.2 * t + 0.8 * t * t)
    hop = 0.12 * abs(math.sin(5 * t))
    place = np.array([0.35 * math.sin(2 * t), hop, 0.3 * math.cos(1.7 * t) - 0.3])

    def at(*local: float) -> tuple[float, ...]:
        return tuple(place + turn @ np.array(local))

    def limb(joint: tuple[float, ...], length: float, half: tuple[float, ...], bent: np.ndarray) -> None:
        b.add(ELLIPSOID, tuple(np.array(at(*joint)) + bent @ np.array([0, -length, 0])), half, (SKIN,), turn=bent)

    b.body()
    b.add(ELLIPSOID, at(0, 1.25, 0), (0.19, 0.33, 0.12), (toys.BLUE, toys.CREAM), tx.STRIPES, 10.0, turn=turn)
    b.add(ELLIPSOID, at(0, 1.72, 0), (0.11, 0.15, 0.13), (SKIN, (0.25, 0.15, 0.1)), tx.BANDS, 0.4, turn=turn)
    for k in range(FLAPS):
        bent = turn @ turn_y(2 * math.pi * k / FLAPS) @ turn_x(-0.5 - 0.25 * math.sin(6 * t + 1.3 * k))
        spot = np.array(at(0, 0.98, 0)) + bent @ np.array([0, -0.22, 0.06])
        colors = ((toys.RED, toys.YELLOW)[k % 2], toys.CREAM)
        b.add(BOX, tuple(spot), (0.09, 0.22, 0.012), colors, tx.DOTS, 9.0, turn=bent)
    for side in (-1, 1):
        limb((0.1 * side, 0.84, 0), 0.42, (0.075, 0.43, 0.08), turn @ turn_x(0.6 * side * math.sin(7 * t)))
        limb(
            (0.18 * side, 1.45, 0), 0.3, (0.05, 0.32, 0.05), turn @ turn_z(side * (1.3 + 0.8 * math.sin(4 * t + side)))
        )
    return b.shapes()


if __name__ == "__main__":
    tyro.cli(main)
