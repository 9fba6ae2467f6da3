"""Draw the subject of a reel from eight sides on one sheet: a row for each frame, a column for each side.

python benchmarks/turntable.py OUT sheet.png --frames 0,29,59
"""

import math
from pathlib import Path

import numpy as np
import tyro
from PIL import Image
from tyro.conf import Positional

from splatreel.play.timeline import Timeline, draw_on_cpu, open_reel
from splatreel.scene.camera import Camera, facing
from splatreel.scene.gaussians import Gaussians

SIDES = 8
ELEVATION = 15.0
"""Degrees from which the cameras look down."""
OPAQUE = 0.5
"""Opacity above which points count for the size of the subject."""
SPAN = 0.02, 0.98
"""Quantiles of positions between which the subject is. Single points may float beside it."""
MARGIN = 1.3
"""Size of what a picture shows at the middle of the subject, as a multiple of the size of the subject."""
DISTANCE = 2.5
"""Distance of the cameras from the subject, as a multiple of its size."""

GRAY = 0.5, 0.5, 0.5
"""Color behind the subject, on which dark hair, white shirts, holes and halos show."""


def main(reel: Positional[Path], out: Positional[Path], /, frames: str | None = None, pixels: int = 320) -> None:
    """Write the sheet.

    Args:
        reel: The reel, or the output folder of a reconstruction.
        out: Image to write.
        frames: Numbers of frames, as A,B,C; by default the first, the middle and the last.
        pixels: Width and height of one picture.
    """
    timeline = open_reel(reel)
    chosen = [int(frame) for frame in frames.split(",")] if frames else first_middle_last(len(timeline))
    write_sheet(timeline, chosen, out, pixels)


def first_middle_last(count: int) -> list[int]:
    """Return the numbers of the first, the middle and the last of `count` frames, each once."""
    return sorted({0, count // 2, count - 1})


def write_sheet(timeline: Timeline, frames: list[int], out: Path, pixels: int = 320) -> None:
    """Draw frames from all sides, and write the sheet as an image."""
    rows = []
    for frame in frames:
        points = timeline[frame]
        views = sides(points, timeline.manifest.up, pixels)
        rows.append(np.concatenate([timeline.render(points, view, on_gray) for view in views], 1))
    out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.rint(255 * np.concatenate(rows)).astype(np.uint8)).save(out)


def on_gray(
    points: Gaussians, camera: Camera, near: float, antialias: bool, _: tuple[float, float, float]
) -> np.ndarray:
    """Draw as `draw_on_cpu`, in front of gray instead of the background of the reel."""
    return draw_on_cpu(points, camera, near, antialias, GRAY)


def sides(points: Gaussians, up: np.ndarray, pixels: int) -> list[Camera]:
    """Return cameras on a circle around the opaque points, which look at their middle.

    Args:
        points: Gaussians of the subject.
        up: Unit up direction, [3].
        pixels: Width and height of the images.
    """
    ahead = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    ahead /= np.linalg.norm(ahead)
    aside = np.cross(up, ahead)
    axes = np.stack([ahead, aside, up], 1)
    low, high = np.quantile(points.means[points.opacities > OPAQUE] @ axes, SPAN, axis=0)
    middle = axes @ ((low + high) / 2)
    size = max(math.hypot(*(high - low)[:2]), high[2] - low[2])
    found = []
    for k in range(SIDES):
        turn, rise = 2 * math.pi * k / SIDES, math.radians(ELEVATION)
        away = math.cos(rise) * (math.cos(turn) * ahead + math.sin(turn) * aside) + math.sin(rise) * up
        center = middle + DISTANCE * size * away
        found.append(facing(str(k), center, -away, DISTANCE * pixels / MARGIN, pixels, pixels, up))
    return found


if __name__ == "__main__":
    tyro.cli(main)
