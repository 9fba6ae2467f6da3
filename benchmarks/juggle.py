"""Film and reconstruct `juggle`: fast arms, a swinging bat and three balls that look alike, from a dome of cameras.

Thirty cameras all around, 26 of them to train on; a ball is twelve pixels wide and flies as far from one frame to the next.

python benchmarks/juggle.py
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

LIGHT = np.array([0.5, 5.0, 0.8])
CAMERAS, PANELS = 30, 12
HELD_OUT = ("cam03", "cam06", "cam10", "cam25")
NOISE, GAIN = 2.0, 0.03
FLIGHT, DWELL = 0.6, 0.3
"""Seconds of a ball in the air and in a hand."""
HAND, THROW, CATCH = 1.05, 0.12, 0.32
"""Height at which balls are thrown and caught, and how far from the middle."""
SWING = 0.5
BATTER = np.array([0.9, 0.0, -0.7])


def main(
    quality: Quality = "standard", frames: int = 60, seed: int = 0, out: Path | None = None, note: str = ""
) -> None:
    """Film, reconstruct, evaluate, record. Images are 320x180."""
    filmed = film()
    reel = filmed.run("juggle", quality, frames, seed, out, note)
    for thing in ("balls", "bat"):
        record(f"juggle, the {thing}", {"cameras": filmed.shows(reel, frames, partial(moving, without=thing))}, note)


def film() -> Film:
    return Film(dome(320, 180), HELD_OUT, standing(), moving, LIGHT, NOISE, GAIN)


def dome(width: int, height: int) -> list[Camera]:
    """Return cameras all around, from knee height to above all heads, that look at the middle."""
    cameras = []
    for i in range(CAMERAS):
        angle, up = i * math.pi * (3 - math.sqrt(5)), math.radians(-8 + 53 * (i * 7 % CAMERAS) / CAMERAS)
        outwards = np.array([math.sin(angle) * math.cos(up), math.sin(up), math.cos(angle) * math.cos(up)])
        center = np.array([0, 1.1, 0]) + 2.8 * outwards
        forward = np.array([0.2 * math.sin(i), 1.1, 0.2 * math.cos(2 * i)]) - center
        cameras.append(facing(f"cam{i:02d}", center, forward / np.linalg.norm(forward), 0.85 * width, width, height))
    return cameras


def standing() -> Shapes:
    """Return a dome of panels, a floor and two boxes."""
    b = Builder()
    b.body(shadows=False)
    b.add(BOX, (0, -0.5, 0), (5, 0.5, 5), ((0.42, 0.4, 0.38), (0.5, 0.47, 0.44)), tx.CHECKS, 1.5, 0.3, occlusion=0)
    for k in range(PANELS):
        angle = 2 * math.pi * k / PANELS
        for row, lean in enumerate((0.0, 0.35)):
            far = 3.5 - 0.3 * row
            place = np.array([far * math.sin(angle), 1.0 + 2 * row, far * math.cos(angle)])
            gray = 0.6 + 0.12 * (k * 5 % 3)
            colors = ((gray, gray, gray + 0.03), (0.35, 0.36, 0.4), toys.CREAM)
            turn = turn_y(angle) @ turn_x(-lean)
            b.add(BOX, tuple(place), (1.0, 1.05, 0.05), colors, tx.DOTS, 2.5, 0.1 * k, turn=turn, occlusion=0)
    b.body()
    b.add(BOX, (-1.1, 0.25, 0.8), (0.25, 0.25, 0.25), (toys.TEAL, toys.CREAM, toys.YELLOW), tx.EMBLEM, turn=turn_y(0.4))
    b.add(CYLINDER, (-0.9, 0.2, -1.0), (0.2, 0.2, 0.2), (toys.ORANGE, toys.WHITE), tx.BANDS, 3.0)
    return b.shapes()


def moving(seconds: float, without: str = "") -> Shapes:
    """Return all moving solids without `balls` or `bat`."""
    b = Builder()
    _juggler(b, seconds)
    _batter(b, seconds, without != "bat")
    if without != "balls":
        for k in range(3):
            b.body()
            b.add(ELLIPSOID, _ball(seconds + k * (FLIGHT + DWELL) * 2 / 3), (0.06,) * 3, ((0.2, 0.75, 0.85),))
    return b.shapes()


def _ball(t: float) -> tuple[float, float, float]:
    """Return the position of a ball in a cascade."""
    turn, u = divmod(t, FLIGHT + DWELL)
    side = 1 if turn % 2 else -1
    if u < FLIGHT:
        x = side * (THROW - (THROW + CATCH) * u / FLIGHT)
        return x, HAND + 4.9 * u * (FLIGHT - u), 0.35
    v = (u - FLIGHT) / DWELL
    return -side * (CATCH - (CATCH - THROW) * v), HAND - 0.12 * math.sin(math.pi * v), 0.35


def _juggler(b: Builder, t: float) -> None:
    """Return the juggler, whose hands follow the balls."""
    _body(b, np.array([0.02 * math.sin(3 * t), 0, 0]), 0.0, ((0.75, 0.2, 0.25), toys.WHITE))
    cycle = 2 * (FLIGHT + DWELL) / 3
    for side in (-1, 1):
        # it carries for DWELL, and for the rest goes back empty
        u = (t + (cycle / 2 if side > 0 else 0) - FLIGHT) % cycle
        share = u / DWELL if u < DWELL else 1 - (u - DWELL) / (cycle - DWELL)
        dip = -0.12 if u < DWELL else 0.04
        x = side * (CATCH - (CATCH - THROW) * share)
        hand = np.array([x, HAND - 0.08 + dip * math.sin(math.pi * share), 0.35])
        _arm(b, np.array([0.22 * side, 1.38, 0.02]), hand, (0.75, 0.2, 0.25))


def _batter(b: Builder, t: float, bat: bool) -> None:
    """Return the batter. The end of the bat moves at ten units per second."""
    u = t % 1.6
    share = min(max((u - 0.3) / SWING, 0.0), 1.0) if u < 1.1 else 1 - (u - 1.1) / SWING
    angle = -1.2 + 3.2 * share * share * (3 - 2 * share)
    _body(b, BATTER, 0.5 * angle - 0.6, (toys.BLUE, toys.YELLOW))
    reach = np.array([math.sin(angle), 0, math.cos(angle)])
    hands = BATTER + np.array([0, 1.1, 0]) + 0.35 * reach
    for side in (-1, 1):
        shoulder = BATTER + np.array([0.2 * side * math.cos(angle), 1.36, -0.2 * side * math.sin(angle)])
        _arm(b, shoulder, hands, toys.BLUE)
    if bat:
        b.body()
        turn = turn_y(angle) @ turn_x(-0.25)
        place = hands + turn @ np.array([0, 0, 0.42])
        b.add(ELLIPSOID, tuple(place), (0.03, 0.03, 0.42), (toys.WOOD, toys.CREAM), tx.STRIPES, 6.0, turn=turn)


def _body(b: Builder, place: np.ndarray, heading: float, shirt: tuple[toys.Color, ...]) -> None:
    """Return a figure without arms."""
    turn = turn_y(heading)
    b.body()
    b.add(ELLIPSOID, tuple(place + np.array([0, 1.12, 0])), (0.22, 0.36, 0.14), shirt, tx.STRIPES, 14.0, turn=turn)
    b.add(
        ELLIPSOID,
        tuple(place + np.array([0, 1.64, 0])),
        (0.11, 0.15, 0.13),
        (SKIN, (0.3, 0.2, 0.15)),
        tx.BANDS,
        0.4,
        turn=turn,
    )
    for side in (-1, 1):
        leg = place + turn @ np.array([0.12 * side, 0.42, 0])
        b.add(ELLIPSOID, tuple(leg), (0.09, 0.44, 0.09), ((0.25, 0.25, 0.35),), turn=turn_z(0.08 * side))


def _arm(b: Builder, shoulder: np.ndarray, hand: np.ndarray, sleeve: toys.Color) -> None:
    """Return a bent arm between two positions."""
    elbow = (shoulder + hand) / 2 - np.array([0, 0.12, 0])
    for start, end, color in ((shoulder, elbow, sleeve), (elbow, hand, SKIN)):
        along = end - start
        length = float(np.linalg.norm(along))
        turn = turn_y(math.atan2(along[0], along[2])) @ turn_x(-math.asin(along[1] / length))
        b.add(ELLIPSOID, tuple((start + end) / 2), (0.05, 0.05, 0.55 * length), (color,), turn=turn)
    b.add(ELLIPSOID, tuple(hand), (0.05, 0.05, 0.05), (SKIN,))


if __name__ == "__main__":
    tyro.cli(main)
