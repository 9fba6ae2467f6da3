"""Plan and elevation of the cameras as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splatreel.evaluation.page.html import escape
from splatreel.scene.camera import Camera, focus_point

SIDE = 360
MARGIN = 40
DOTS = 400
"""Maximum number of points of the scene in a drawing."""
_ARROW = 16
"""Length of a camera's arrow in pixels."""
NAMED = 60
"""Number of cameras up to which a drawing has names. A name that would cover another one or a camera is left out."""
LETTER, LINE = 6.2, 11.0
"""Width of a letter and height of a line in pixels, for names."""


@dataclass(frozen=True)
class RigPlan:
    """Cameras and points of a scene, to be drawn from above and from the side.

    Attributes:
        cameras: Cameras that trained.
        held_out: Cameras that were compared with.
        up: Up direction of the world, [3].
        points: Points of the scene, [N, 3].
        links: Lines between two of `cameras`, by number, and their opacity, 0..1.
    """

    cameras: Sequence[Camera]
    held_out: Sequence[Camera]
    up: np.ndarray
    points: np.ndarray
    links: Sequence[tuple[int, int, float]] = ()

    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return unit vectors to the right and to the back of the drawing, and up."""
        up = np.asarray(self.up, np.float64) / max(float(np.linalg.norm(self.up)), 1e-12)
        forward = np.mean([camera.forward for camera in self.cameras], axis=0).astype(np.float64)
        forward -= up * (up @ forward)
        if np.linalg.norm(forward) < 1e-3:  # cameras all around: any horizontal direction serves
            forward = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
        forward /= np.linalg.norm(forward)
        return np.cross(forward, up), forward, up

    def drawings(self) -> tuple[str, str]:
        """Return the plan (from above) and the elevation (from the side of the mean camera's back) as SVG elements."""
        right, back, up = self.axes()
        count = len(self.cameras) + len(self.held_out)
        return (
            self._draw(right, back, f"Plan of {count} cameras, from above"),
            self._draw(right, up, f"Elevation of {count} cameras, seen from behind them"),
        )

    def _draw(self, right: np.ndarray, down: np.ndarray, label: str) -> str:
        """Draw with `right` to the right and `down` to the top."""
        everything = [*self.cameras, *self.held_out]
        centers = np.stack([camera.center for camera in everything]).astype(np.float64)
        focus = focus_point(list(self.cameras))
        frame = np.stack([right, down])
        shown = np.concatenate([centers, focus[None]]) @ frame.T
        middle, size = (shown.min(0) + shown.max(0)) / 2, max(float(np.ptp(shown, axis=0).max()), 1e-9)
        scale = (SIDE - 2 * MARGIN) / size

        def place(points: np.ndarray) -> np.ndarray:
            flat = (points @ frame.T - middle) * scale
            return np.stack([SIDE / 2 + flat[:, 0], SIDE / 2 - flat[:, 1]], 1).round(1)

        parts = [f'<svg viewBox="0 0 {SIDE} {SIDE}" role="img" aria-label="{escape(label)}">']
        dots = place(self.points[:: max(len(self.points) // DOTS, 1)])
        inside = dots[((dots > 0) & (dots < SIDE)).all(1)]
        parts += [f'<circle class="dot" cx="{x}" cy="{y}" r="1"/>' for x, y in inside.tolist()]
        ends = place(centers).tolist()
        parts += [
            f'<path class="link" opacity="{strength:.2f}" d="M{ends[a][0]} {ends[a][1]}L{ends[b][0]} {ends[b][1]}"/>'
            for a, b, strength in self.links
        ]
        x, y = place(focus[None])[0].tolist()
        parts.append(f'<path class="focus" d="M{x - 6} {y}h12M{x} {y - 6}v12"/>')
        forward = np.stack([camera.forward for camera in everything]) @ frame.T
        taken = [(x - 5, y - 5, x + 5, y + 5) for x, y in ends]
        for camera, (x, y), (dx, dy) in zip(everything, ends, forward.tolist(), strict=True):
            kind = "held" if camera in self.held_out else "train"
            arrow = f"M{x} {y}l{round(_ARROW * dx, 1)} {round(-_ARROW * dy, 1)}"
            mark = (
                f'<rect x="{x - 4}" y="{y - 4}" width="8" height="8"/>'
                if kind == "held"
                else f'<circle cx="{x}" cy="{y}" r="4"/>'
            )
            parts.append(f'<g class="{kind}"><title>{escape(camera.name)}</title><path d="{arrow}"/>{mark}</g>')
        if len(everything) <= NAMED:
            # Names of held-out cameras come first: there are few of them.
            order = sorted(range(len(everything)), key=lambda c: everything[c] not in self.held_out)
            for c in order:
                name = everything[c].name
                if at := _free_place(len(name) * LETTER, ends[c], float(forward[c, 1]), taken):
                    parts.append(f'<text class="name" x="{at[0]:.1f}" y="{at[1]:.1f}">{escape(name)}</text>')
        return "".join([*parts, "</svg>"])


def _free_place(
    width: float, camera: list[float], ahead: float, taken: list[tuple[float, float, float, float]]
) -> tuple[float, float] | None:
    """Return the start of the baseline of a name beside a camera, and mark its place as taken; None without room.

    Args:
        width: Width of the name.
        camera: Place of the camera, (x, y).
        ahead: Upward part of the camera's direction. The name is rather behind the camera than before it.
        taken: Boxes (left, top, right, bottom) of other names and of cameras.
    """
    x, y = camera
    behind, before = (y + LINE + 6, y - 7) if ahead > 0 else (y - 7, y + LINE + 6)
    middle, side = x - width / 2, y + LINE / 2 - 1
    for left, base in ((middle, behind), (x + 8, side), (x - 8 - width, side), (middle, before), (x + 8, behind)):
        box = left, base - LINE, left + width, base + 2
        inside = left >= 0 and left + width <= SIDE and box[1] >= 0 and box[3] <= SIDE
        free = all(box[0] >= c or box[2] <= a or box[1] >= d or box[3] <= b for a, b, c, d in taken)
        if inside and free:
            taken.append(box)
            return left, base
    return None


def rig_drawings(plan: RigPlan) -> str:
    """Return the plan and the elevation of the cameras, with a legend."""
    titles = ("Plan, from above", "Elevation, from behind")
    parts = [f"<section><h3>{title}</h3>{svg}</section>" for title, svg in zip(titles, plan.drawings(), strict=True)]
    lines = '<li class="s2">most points in common (two lines a camera; the darker, the more)</li>' if plan.links else ""
    legend = f'<ul class="keys"><li class="s0">trained (circle)</li><li class="s1">held out (square)</li>{lines}</ul>'
    return f'{legend}<div class="charts rig">{"".join(parts)}</div>'
