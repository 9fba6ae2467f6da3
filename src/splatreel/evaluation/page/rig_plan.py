"""Plan and elevation of the cameras as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splatreel.evaluation.page.escaping import escape
from splatreel.scene.camera import Camera, focus_point

SIDE = 360
MARGIN = 40
DOTS = 400
"""Maximum number of points of the scene in a drawing."""
ARROW = 16
"""Length of a camera's arrow in pixels."""


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
        for camera, (x, y), (dx, dy) in zip(everything, ends, forward.tolist(), strict=True):
            kind = "held" if camera in self.held_out else "train"
            arrow = f"M{x} {y}l{round(ARROW * dx, 1)} {round(-ARROW * dy, 1)}"
            mark = (
                f'<rect x="{x - 4}" y="{y - 4}" width="8" height="8"/>'
                if kind == "held"
                else f'<circle cx="{x}" cy="{y}" r="4"/>'
            )
            parts.append(f'<g class="{kind}"><title>{escape(camera.name)}</title><path d="{arrow}"/>{mark}</g>')
            if kind == "held" or len(everything) <= 12:
                # Names must not leave the drawing.
                at = f'x="{x - 6}" text-anchor="end"' if x > SIDE / 2 else f'x="{x + 6}"'
                parts.append(f'<text {at} y="{y - 6}">{escape(camera.name)}</text>')
        return "".join([*parts, "</svg>"])
