"""Film and reconstruct `studio`: twenty unsynchronized phones with changing exposures before a paper backdrop.

Phones on 190 degrees, seventeen of them to train on. A dancer turns close to them, faster and faster, with a scarf that waves as
nothing in the other films does; a wheel of six blades spins; a person walks in.

python benchmarks/studio.py
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

LIGHT = np.array([1.5, 4.5, 3.0])
CAMERAS, PANELS = 20, 9
HELD_OUT = ("cam04", "cam09", "cam15")
NOISE, GAIN, DRIFT, LATE = 2.5, 0.05, 0.04, 0.5
SCARF = 14
WHEEL = np.array([-1.15, 1.0, -0.5])


def main(
    quality: Quality = "standard",
    frames: int = 45,
    seed: int = 0,
    drift: float = DRIFT,
    late: float = LATE,
    out: Path | None = None,
    note: str = "",
) -> None:
    """Film, reconstruct, evaluate, record. Images are 320x180.

    drift: how far exposures go, as the logarithm of a gain. late: frames by which phones are out of step at most.
    """
    filmed = film(drift, late)
    reel = filmed.run("studio", quality, frames, seed, out, note)
    record("studio, the scarf", {"cameras": filmed.shows(reel, frames, partial(moving, scarf=False))}, note)


def film(drift: float = 0.0, late: float = 0.0) -> Film:
    """Return the film; by default synchronized and evenly exposed, so that all cameras agree on positions."""
    return Film(arc(320, 180), HELD_OUT, standing(), moving, LIGHT, NOISE, GAIN, drift, late)


def arc(width: int, height: int) -> list[Camera]:
    """Return phones of two focal lengths on tripods of three heights, most of them turned to the dancer."""
    cameras = []
    for i in range(CAMERAS):
        angle, radius = math.radians(-95 + 190 * i / (CAMERAS - 1)), 2.7 + 0.3 * (i * 7 % 3)
        center = np.array([radius * math.sin(angle), 0.8 + 0.6 * (i * 2 % 3), radius * math.cos(angle)])
        forward = np.array([0.15 * math.sin(3 * i), 1.05, 0.15 * math.cos(i)]) - center
        focal = (0.75 if i % 4 else 0.9) * width
        cameras.append(facing(f"cam{i:02d}", center, forward / np.linalg.norm(forward), focal, width, height))
    return cameras


def standing() -> Shapes:
    """Return a paper backdrop that bends into the floor, things in front of it, and stands behind the phones."""
    b = Builder()
    b.body(shadows=False)
    paper = (0.72, 0.73, 0.75)
    b.add(BOX, (0, -0.5, 0), (6, 0.5, 6), (paper, (0.7, 0.71, 0.73)), tx.PLANKS, 0.5, 0.3, occlusion=0)
    for k in range(PANELS):
        angle = math.pi - 1.25 + 2.5 * k / (PANELS - 1)
        place = np.array([2.3 * math.sin(angle), 1.6, 2.3 * math.cos(angle)])
        b.add(BOX, tuple(place), (0.42, 1.6, 0.03), (paper,), turn=turn_y(angle), occlusion=0)
    for k in range(8):
        angle = -1.6 + 3.2 * k / 7
        place = np.array([4.6 * math.sin(angle), 1.1, 4.6 * math.cos(angle)])
        colors = (((0.3, 0.3, 0.33), toys.TEAL, toys.WOOD)[k % 3], toys.CREAM)
        b.add(BOX, tuple(place), (0.7, 1.1, 0.2), colors, tx.CHECKS, 2.0, 0.2 * k, turn=turn_y(angle), occlusion=0)
    b.body()
    b.add(BOX, (1.2, 0.22, -0.6), (0.22, 0.22, 0.22), (toys.RED, toys.CREAM, toys.YELLOW), tx.EMBLEM, turn=turn_y(0.5))
    b.add(CYLINDER, tuple(WHEEL * (1, 0.5, 1)), (0.03, 0.5, 0.03), (toys.BLACK,))
    b.add(BOX, (0.2, 0.15, -1.5), (0.6, 0.15, 0.2), (toys.WOOD, toys.CREAM), tx.PLANKS, 5.0)
    return b.shapes()


def moving(seconds: float, scarf: bool = True) -> Shapes:
    b = Builder()
    heading = 2 * math.pi * (0.35 * seconds + 0.25 * seconds * seconds)
    place = np.array([0.25 * math.sin(1.5 * seconds), 0, 0.1])
    _dancer(b, seconds, place, heading)
    if scarf:
        _scarf(b, seconds, place, heading)
    _wheel(b, seconds)
    _visitor(b, seconds)
    return b.shapes()


def _dancer(b: Builder, t: float, place: np.ndarray, heading: float) -> None:
    """Return the dancer, who turns faster and faster with rising arms and a swinging leg."""
    turn = turn_y(heading)

    def at(*local: float) -> tuple[float, ...]:
        return tuple(place + turn @ np.array(local))

    b.body()
    b.add(ELLIPSOID, at(0, 1.2, 0), (0.2, 0.34, 0.13), (toys.PURPLE, toys.PINK), tx.STRIPES, 12.0, turn=turn)
    b.add(ELLIPSOID, at(0, 0.86, 0), (0.3, 0.16, 0.3), (toys.PURPLE, toys.YELLOW), tx.SECTORS, 5.0, turn=turn)
    b.add(ELLIPSOID, at(0, 1.7, 0), (0.11, 0.15, 0.13), (SKIN, (0.25, 0.15, 0.1)), tx.BANDS, 0.4, turn=turn)
    b.add(ELLIPSOID, at(-0.08, 0.42, 0), (0.08, 0.44, 0.08), (toys.TEAL,), turn=turn)
    out = 0.5 + 0.5 * math.sin(4 * t)
    bent = turn @ turn_z(out)
    hip = np.array([0.08, 0.84, 0])
    leg = place + turn @ hip + bent @ np.array([0, -0.42, 0])
    b.add(ELLIPSOID, tuple(leg), (0.08, 0.44, 0.08), (toys.TEAL, toys.CREAM), tx.BANDS, 3.0, turn=bent)
    for side in (-1, 1):
        bent = turn @ turn_z(side * (1.2 + 0.6 * math.sin(3 * t + side)))
        arm = place + turn @ np.array([0.19 * side, 1.43, 0]) + bent @ np.array([0, -0.3, 0])
        b.add(ELLIPSOID, tuple(arm), (0.05, 0.33, 0.05), (SKIN,), turn=bent)


def _scarf(b: Builder, t: float, place: np.ndarray, heading: float) -> None:
    """Return a band of cloth that hangs from a hand. Each part follows the part before it with a delay."""
    b.body()
    for k in range(SCARF):
        lag = 0.05 * k
        angle = heading - 1.3 * lag * (0.7 + t) * math.pi
        far = 0.55 + 0.02 * k
        sway = 0.1 * math.sin(9 * t - 0.7 * k) * min(1.0, k / 5)
        spot = np.array([far * math.cos(angle), 1.35 - 0.035 * k + sway, -far * math.sin(angle)]) + place
        colors = ((toys.ORANGE, toys.YELLOW)[k % 2], toys.CREAM)
        turn = turn_y(angle) @ turn_x(0.6 * math.cos(9 * t - 0.7 * k))
        b.add(BOX, tuple(spot), (0.012, 0.09, 0.06), colors, tx.STRIPES, 8.0, turn=turn)


def _wheel(b: Builder, t: float) -> None:
    """Return a wheel of six blades, two turns per second."""
    b.body()
    for k in range(6):
        turn = turn_z(4 * math.pi * t + k * math.pi / 3)
        place = WHEEL + turn @ np.array([0, 0.2, 0.06])
        color = (toys.RED, toys.WHITE, toys.BLUE)[k % 3]
        b.add(ELLIPSOID, tuple(place), (0.06, 0.2, 0.015), (color,), turn=turn)
    b.add(ELLIPSOID, tuple(WHEEL + np.array([0, 0, 0.08])), (0.05, 0.05, 0.03), (toys.YELLOW,))


def _visitor(b: Builder, t: float) -> None:
    """Return the visitor, who walks in from an unseen side and past the dancer."""
    x = 3.2 - 2.2 * max(0.0, t - 0.3)
    place, swing = np.array([x, 0, 1.05]), 0.6 * math.sin(8 * t)
    turn = turn_y(-math.pi / 2)
    b.body()
    b.add(ELLIPSOID, (x, 1.15, 1.05), (0.2, 0.36, 0.13), (toys.GREEN, toys.CREAM), tx.CHECKS, 6.0, turn=turn)
    b.add(ELLIPSOID, (x, 1.66, 1.05), (0.11, 0.15, 0.13), (SKIN, (0.6, 0.5, 0.3)), tx.BANDS, 0.4, turn=turn)
    for side in (-1, 1):
        bent = turn @ turn_x(swing * side)
        hip = place + turn @ np.array([0.1 * side, 0.85, 0])
        b.add(ELLIPSOID, tuple(hip + bent @ np.array([0, -0.42, 0])), (0.08, 0.44, 0.08), (toys.BLUE,), turn=bent)
        bent = turn @ turn_x(-swing * side)
        shoulder = place + turn @ np.array([0.26 * side, 1.42, 0])
        b.add(ELLIPSOID, tuple(shoulder + bent @ np.array([0, -0.3, 0])), (0.05, 0.32, 0.05), (toys.GREEN,), turn=bent)


if __name__ == "__main__":
    tyro.cli(main)
