"""Scene of the built-in capture: a toy room with a turning globe, a bouncing ball, a plane that flies in and a train that sets off.

World: x right, y up, z towards the cameras; the floor is y = 0. Times are in seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from toyroom import textures as tx
from toyroom.solids import BOX, CYLINDER, ELLIPSOID, POSITION, REACH, ROTATION, Shapes

LIGHT = np.array([1.3, 4.6, 3.4])
PLANE_ENTERS = 0.4
TRAIN_STARTS = 1.2
BALL_RADIUS, BALL_REACH, BALL_SPEED, BALL_HOP = 0.16, 1.44, 2.7, 0.62
"""Radius of the ball, its reach to either side, its speed, and the seconds between bounces."""
BALL_START, BALL_PHASE = 0.6, 0.25
"""State of the ball at time 0: distance from the left end, and phase of the bounce."""

Color = tuple[float, float, float]
WHITE, CREAM, BLACK = (0.95, 0.94, 0.9), (0.93, 0.86, 0.7), (0.09, 0.09, 0.11)
RED, ORANGE, YELLOW = (0.82, 0.16, 0.14), (0.93, 0.5, 0.13), (0.96, 0.78, 0.2)
GREEN, TEAL, BLUE = (0.27, 0.6, 0.25), (0.15, 0.5, 0.52), (0.16, 0.33, 0.72)
PURPLE, PINK, WOOD = (0.47, 0.25, 0.6), (0.92, 0.5, 0.55), (0.62, 0.4, 0.22)


def _linear(color: Color) -> list[float]:
    return [((c + 0.055) / 1.055) ** 2.4 for c in color]


class Builder:
    """Builder that collects solids and packs them as `Shapes`."""

    def __init__(self) -> None:
        self._solids: list[np.ndarray] = []
        self._bodies: list[tuple[int, bool]] = []

    def body(self, shadows: bool = True) -> None:
        """Start a body, to which the following solids belong. Neighboring solids share a body, so that rays skip them together."""
        self._bodies.append((len(self._solids), shadows))

    def add(
        self,
        kind: int,
        position: tuple[float, ...],
        half: tuple[float, ...],
        colors: tuple[Color, ...],
        texture: int = tx.SOLID,
        scale: float = 1.0,
        phase: float = 0.0,
        turn: np.ndarray | None = None,
        occlusion: float = 0.35,
    ) -> None:
        """Add a solid. With fewer than three colors the last is repeated."""
        three = np.array([_linear(c) for c in (*colors, colors[-1], colors[-1])[:3]])
        rotation = np.eye(3) if turn is None else turn
        reach = {BOX: math.hypot(*half), ELLIPSOID: max(half), CYLINDER: math.hypot(max(half[0], half[2]), half[1])}[
            kind
        ]
        numbers = [kind, texture, scale, phase, occlusion, reach]
        self._solids.append(np.concatenate([numbers, position, half, rotation.ravel(), three.ravel()]))

    def shapes(self) -> Shapes:
        """Return all solids."""
        solids = np.stack(self._solids)
        ends = [first for first, _ in self._bodies[1:]] + [len(solids)]
        bodies = []
        for (first, shadows), end in zip(self._bodies, ends, strict=True):
            position, reach = solids[first:end, POSITION : POSITION + 3], solids[first:end, REACH]
            center = ((position - reach[:, None]).min(0) + (position + reach[:, None]).max(0)) / 2
            radius = (np.linalg.norm(position - center, axis=1) + reach).max()
            bodies.append([*center, radius, first, end, shadows])
        return Shapes(solids, np.array(bodies, float))


def turn_y(angle: float) -> np.ndarray:
    """Return the rotation by an angle in radians about the vertical axis."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def turn_z(angle: float) -> np.ndarray:
    """Return the rotation by an angle in radians about the z axis."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def turn_x(angle: float) -> np.ndarray:
    """Return the rotation by an angle in radians about the x axis."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def standing(seed: int = 0) -> Shapes:
    """Return the solids that never move. `seed` varies texture phases and the positions of the blocks slightly."""
    rng = np.random.default_rng(seed)
    b = Builder()
    _room(b, rng)
    _books(b, rng)
    _mirror(b)
    _toys(b, rng)
    return b.shapes()


def _room(b: Builder, rng: np.random.Generator) -> None:
    phase = rng.uniform(0, 1)
    b.body(shadows=False)  # floor and walls surround the lamp
    b.add(BOX, (0, -0.5, 0), (5, 0.5, 5), (WOOD, (0.78, 0.56, 0.34)), tx.PLANKS, 2.6, phase, occlusion=0)
    paper = ((0.55, 0.73, 0.72), (0.66, 0.81, 0.77), CREAM)
    b.add(BOX, (0, 1.5, -2.0), (3.4, 2.0, 0.2), paper, tx.WALLPAPER, 1.7, phase, occlusion=0)
    for side in (-1, 1):
        b.add(BOX, (3.2 * side, 1.5, 0), (0.2, 2.0, 2.5), paper, tx.WALLPAPER, 1.7, phase, occlusion=0)
    b.add(BOX, (0, 0.09, -1.78), (3.0, 0.09, 0.03), (WHITE,), occlusion=0)
    b.add(BOX, (0, 0.72, -1.79), (3.0, 0.04, 0.03), (WHITE,), occlusion=0)
    b.add(
        BOX,
        (0, 0.43, -1.8),
        (3.0, 0.27, 0.012),
        ((0.83, 0.8, 0.72), (0.62, 0.74, 0.72)),
        tx.CHECKS,
        14.0,
        0.4,
        occlusion=0,
    )
    b.add(
        CYLINDER,
        (0, 0.01, 0.15),
        (1.45, 0.012, 1.05),
        (PINK, CREAM, RED),
        tx.RINGS,
        17.0,
        rng.uniform(0, 6),
        occlusion=0,
    )
    b.add(BOX, (0.55, 1.55, -1.78), (0.55, 0.42, 0.04), (WOOD,), occlusion=0)
    image = ((0.98, 0.62, 0.4), (0.36, 0.5, 0.8), (0.3, 0.42, 0.36))
    b.add(BOX, (0.55, 1.55, -1.76), (0.48, 0.35, 0.04), image, tx.PAINTING, occlusion=0)


def _books(b: Builder, rng: np.random.Generator) -> None:
    """Add a shelf with books of two colors each."""
    b.body()
    b.add(BOX, (-0.85, 1.14, -1.62), (0.75, 0.03, 0.18), (WOOD,), occlusion=0.15)
    x = -1.5
    for main, band in zip(
        (RED, BLUE, YELLOW, GREEN, PURPLE, ORANGE, TEAL), (CREAM, YELLOW, RED, WHITE, PINK, BLUE, CREAM), strict=True
    ):
        half = (rng.uniform(0.05, 0.075), rng.uniform(0.19, 0.27), 0.13)
        place = (x + half[0], 1.17 + half[1], -1.64)
        b.add(BOX, place, half, (main, band), tx.BANDS, rng.uniform(0.35, 0.7), occlusion=0.1)
        x += 2 * half[0] + 0.004
    b.add(
        ELLIPSOID, (-0.33, 1.33, -1.62), (0.15, 0.17, 0.15), (TEAL, YELLOW, CREAM), tx.STRIPES, 30.0, 1.0, occlusion=0.1
    )


def _mirror(b: Builder) -> None:
    """Add a standing mirror at the left, facing the middle of the room."""
    turn = turn_y(0.62) @ turn_x(-0.06)
    center = np.array([-1.42, 0.62, -0.85])
    b.body()
    b.add(BOX, tuple(center), (0.40, 0.58, 0.03), (ORANGE, YELLOW), tx.STRIPES, 26.0, turn=turn, occlusion=0.2)
    b.add(
        BOX,
        tuple(center + turn @ (0, 0, 0.02)),
        (0.33, 0.51, 0.03),
        ((0.9, 0.92, 0.93),),
        tx.MIRROR,
        turn=turn,
        occlusion=0,
    )


def _toys(b: Builder, rng: np.random.Generator) -> None:
    b.body()
    b.add(CYLINDER, (0.02, 0.19, -0.75), (0.3, 0.19, 0.3), (CREAM, BLUE), tx.STRIPES, 33.0)
    b.add(CYLINDER, (0.02, 0.41, -0.75), (0.1, 0.035, 0.1), (BLACK,), occlusion=0.2)
    faces = ((CREAM, RED, BLUE), (CREAM, GREEN, RED), (CREAM, BLUE, ORANGE), (YELLOW, PURPLE, TEAL))
    places = ((1.2, 0.2, -0.75), (1.62, 0.2, -0.55), (1.4, 0.6, -0.67), (0.83, 0.14, -0.42))
    b.body()
    for colors, place in zip(faces, places, strict=True):
        half = 0.14 if place[1] == 0.14 else 0.2
        b.add(BOX, place, (half,) * 3, colors, tx.EMBLEM, turn=turn_y(rng.uniform(-0.5, 0.5)))
    b.body()
    for i, color in enumerate((RED, ORANGE, YELLOW, GREEN, BLUE)):
        radius = 0.25 - 0.035 * i
        b.add(CYLINDER, (-0.86, 0.065 + 0.11 * i, -0.3), (radius, 0.05, radius), (color,), occlusion=0.25)
    b.add(ELLIPSOID, (-0.86, 0.62, -0.3), (0.08, 0.08, 0.08), (PURPLE,), occlusion=0.1)
    for side, color in ((-1, TEAL), (1, PURPLE)):
        b.body()
        b.add(BOX, (1.72 * side, 0.19, 0.75), (0.11, 0.19, 0.28), (color, CREAM), tx.DOTS, 5.5, 0.2)


def moving(seconds: float) -> Shapes:
    """Return the solids that move at some time, as they are at a time; always the same ones in the same order."""
    b = Builder()
    _globe(b, seconds)
    _ball(b, seconds)
    _plane(b, seconds)
    _train(b, seconds)
    return b.shapes()


def in_motion(seconds: float) -> np.ndarray:
    """Return which solids of `moving` are in motion at a time, [N] bool."""
    place = slice(POSITION, POSITION + 3), slice(ROTATION, ROTATION + 9)
    now, soon = moving(seconds).solids, moving(seconds + 1e-3).solids
    return np.any([np.abs(now[:, part] - soon[:, part]).max(1) > 1e-9 for part in place], axis=0)


def _globe(b: Builder, t: float) -> None:
    """Add the slowly turning globe: two thirds of a radian per second."""
    colors = ((0.14, 0.42, 0.68), (0.5, 0.62, 0.22), WHITE)
    b.body()
    b.add(ELLIPSOID, (0.02, 0.8, -0.75), (0.38,) * 3, colors, tx.GLOBE, 2.0, 3.0, turn=turn_z(-0.3) @ turn_y(0.66 * t))


def ball(t: float) -> tuple[float, float, float]:
    """Return the center of the ball."""
    way = (BALL_SPEED * t + BALL_START) % (4 * BALL_REACH)
    x = way - BALL_REACH if way < 2 * BALL_REACH else 3 * BALL_REACH - way
    phase = (t / BALL_HOP + BALL_PHASE) % 1.0
    return x, BALL_RADIUS + 0.012 + 4 * phase * (1 - phase) * 0.5, 0.75


@dataclass(frozen=True)
class Impact:
    """Impact of the ball.

    Attributes:
        time: Time in seconds.
        place: Point of contact.
        on: floor or bumper.
        strength: Strength relative to the strongest impact.
    """

    time: float
    place: tuple[float, float, float]
    on: str
    strength: float


def impacts(seconds: float) -> list[Impact]:
    """Return all impacts of the first seconds, sorted by time."""
    bounces = [(k - BALL_PHASE) * BALL_HOP for k in range(1, math.ceil(seconds / BALL_HOP + BALL_PHASE) + 1)]
    crossing = 2 * BALL_REACH / BALL_SPEED
    turns = [k * crossing - BALL_START / BALL_SPEED for k in range(1, math.ceil(seconds / crossing) + 2)]
    found = []
    for time in bounces:
        x, y, z = ball(time)
        found.append(Impact(time, (x, y - BALL_RADIUS, z), "floor", 1.0))
    for time in turns:
        x, y, z = ball(time)
        found.append(Impact(time, (x + math.copysign(BALL_RADIUS, x), y, z), "bumper", 0.6))
    return sorted((impact for impact in found if impact.time < seconds), key=lambda impact: impact.time)


def _ball(b: Builder, t: float) -> None:
    """Add the fast object: it bounces between two bumpers, 6 to 8 pixels per frame at the default size."""
    place = ball(t)
    turn = turn_z(-2.0 * place[0] / BALL_REACH) @ turn_x(0.5)
    b.body()
    b.add(ELLIPSOID, place, (BALL_RADIUS,) * 3, (RED, WHITE, YELLOW), tx.SECTORS, 3.0, turn=turn)


def _plane(b: Builder, t: float) -> None:
    """Add the plane, which flies in from the right at about PLANE_ENTERS, then circles."""
    radius, speed = 0.85, 1.7
    x_straight = 2.0 - speed * (t - PLANE_ENTERS)
    angle = max(0.0, -x_straight / radius)
    place = np.array([x_straight if x_straight > 0 else -radius * math.sin(angle), 0, radius * math.cos(angle) - 0.5])
    bank = 0.35 * min(1.0, max(0.0, (1.0 - x_straight)))
    place[1] = 1.42 + 0.06 * math.sin(2.5 * t)
    frame = turn_y(math.pi + angle) @ turn_x(-bank)  # local x is the direction of flight

    b.body()

    def part(kind: int, at: tuple[float, float, float], half: tuple[float, ...], *rest, **more) -> None:
        b.add(kind, tuple(place + frame @ at), half, *rest, turn=frame, **more)

    part(ELLIPSOID, (0, 0, 0), (0.36, 0.095, 0.09), (YELLOW, RED), tx.STRIPES, 30.0)
    part(BOX, (0.06, 0.02, 0), (0.1, 0.018, 0.42), (RED, CREAM), tx.DOTS, 7.0)
    part(BOX, (-0.3, 0.03, 0), (0.06, 0.015, 0.16), (RED,))
    part(BOX, (-0.31, 0.1, 0), (0.055, 0.1, 0.015), (BLUE,))
    part(ELLIPSOID, (0.05, 0.08, 0), (0.1, 0.06, 0.055), ((0.6, 0.8, 0.9),))


def _train(b: Builder, t: float) -> None:
    """Add the train, which rests until TRAIN_STARTS, then runs to and fro in front of the globe's stand."""
    x = -0.95 + 0.8 * (1 - math.cos(1.35 * max(0.0, t - TRAIN_STARTS)))
    roll = -(x + 0.95) / 0.09

    b.body()

    def part(kind: int, at: tuple[float, float, float], half: tuple[float, ...], *rest, **more) -> None:
        b.add(kind, (x + at[0], at[1], 0.22 + at[2]), half, *rest, **more)

    part(BOX, (0, 0.14, 0), (0.36, 0.04, 0.13), (BLACK,))
    part(CYLINDER, (0.1, 0.29, 0), (0.12, 0.24, 0.12), (GREEN, YELLOW), tx.STRIPES, 26.0, turn=turn_z(math.pi / 2))
    part(BOX, (-0.22, 0.34, 0), (0.13, 0.17, 0.13), (RED, CREAM, BLUE), tx.EMBLEM)
    part(BOX, (-0.22, 0.53, 0), (0.17, 0.025, 0.16), (BLUE,))
    part(CYLINDER, (0.22, 0.46, 0), (0.05, 0.09, 0.05), (BLACK, RED), tx.STRIPES, 30.0)
    for at in (-0.22, 0.02, 0.24):
        part(
            CYLINDER,
            (at, 0.1, 0.0),
            (0.09, 0.15, 0.09),
            (RED, YELLOW),
            tx.SECTORS,
            2.0,
            turn=turn_z(roll) @ turn_x(math.pi / 2),
        )
