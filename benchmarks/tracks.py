"""Measure the tracker against the truth: the share of points that stay on the solid on which they started.

They start where they belong and nothing is trained, so that only the tracker is judged.

python benchmarks/tracks.py
"""

import time
from contextlib import closing
from pathlib import Path

import numpy as np
import tyro

import cove
import dominoes
import juggle
import kitchen
import studio
import yard
from film import FPS, Film
from record import record
from splatreel.capture.base import Capture
from splatreel.capture.opening import open_capture
from splatreel.config import preset
from splatreel.method.images.flow import make_flow
from splatreel.method.tracking.track import PointTracks, Tracker, identity_quats
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from toyroom.raytracer import trace_cover, trace_static
from toyroom.solids import HALF, POSITION, ROTATION, Shapes

FILMS = {"cove": cove, "dominoes": dominoes, "juggle": juggle, "kitchen": kitchen, "studio": studio, "yard": yard}
SPACING, OFF = 1.6, 3.0
"""Pixels between two points at their median depth, and from a solid, above which a point is no longer on it."""
STATIC_PIXELS = 1.0
"""Pixels; a solid that goes less far is left out."""
LOOKS = (8, 16, 24, 34)
"""Frames of which the share is told by itself."""
SKY = 100.0
"""Depth above which nothing stands."""


def main(films: tuple[str, ...] = tuple(FILMS), frames: int = 35, out: Path = Path("out"), note: str = "") -> None:
    """Film what is missing, track one group, print, record.

    Args:
        films: Names of benchmarks.
    """
    values = {}
    for name in films:
        film: Film = FILMS[name].film()
        path = out / f"benchmark-tracks-{name}-{frames}"
        if not path.exists():
            film.write(path, frames)
        with closing(open_capture(path)) as capture:
            values[name] = followed(film, capture)
        print(f"{name}: {values[name]}")
    record("tracks", {"frames": frames, "films": values}, note)


def followed(film: Film, capture: Capture) -> dict:
    """Return how many points of one film stay on their solids."""
    cameras = capture.training_cameras
    frames = capture.read(0, capture.frames, [camera.name for camera in cameras])
    seen = [_seen(film, camera) for camera in cameras]
    depth = np.median(np.concatenate([depths for _, _, depths in seen]))
    pixel = float(depth / cameras[0].K[0, 0])
    moving, static = (_points(np.concatenate([s[k] for s in seen]), SPACING * pixel) for k in (0, 1))
    started = time.monotonic()
    tracker = Tracker(static, cameras, frames, make_flow(preset("standard").layering.flow), 0.1 * float(depth))
    track = PointTracks(moving, 0)
    for frame in range(len(frames) - 1):
        tracker.step([track], frame)
    seconds = time.monotonic() - started
    on = _on(film, track.positions.astype(np.float64), pixel)
    shares = {str(frame): round(float(on[frame].mean()), 4) for frame in LOOKS if frame < len(on)}
    return {
        "points": on.shape[1],
        "on": round(float(on[1:].mean()), 4),
        "on_at": shares,
        "seconds": round(seconds, 1),
    }


def _seen(film: Film, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points of a camera's first frame: [M, 3] on moving solids, [S, 3] on static ones, and the depths [M] of the first."""
    scene = film.moving(0.0)
    cover, depth = trace_cover(
        camera, trace_static(camera, film.still, film.light), scene, np.ones(len(scene.solids), bool)
    )
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(camera.K.astype(np.float64)).T
    places = (rays * depth[..., None] - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
    all_of_it = cover > 0.99
    return places[all_of_it], places[(cover == 0) & (depth < SKY)], depth[all_of_it]


def _points(places: np.ndarray, spacing: float) -> Gaussians:
    """Return opaque round Gaussians at these positions, one in each cell of a grid."""
    means = places[np.unique(np.floor(places / spacing).astype(np.int64), axis=0, return_index=True)[1]]
    count = len(means)
    scales = np.full((count, 3), 0.7 * spacing, np.float32)
    opacities, sh = np.full(count, 0.95, np.float32), np.zeros((count, 1, 3), np.float32)
    return Gaussians(means.astype(np.float32), identity_quats(count), scales, opacities, sh)


def _on(film: Film, places: np.ndarray, pixel: float) -> np.ndarray:
    """Return [T, P] bool, True for points of places [T, N, 3] on the solid they began on. Only moving solids count."""
    scenes = [film.moving(frame / FPS) for frame in range(len(places))]
    first = np.stack([_distance(scenes[0], solid, places[0]) for solid in range(len(scenes[0].solids))])
    owner, there = first.argmin(0), first.min(0) < OFF / 2 * pixel
    columns = []
    for solid in range(len(first)):
        chosen = there & (owner == solid)
        way = np.stack([_carried(scenes[0], scene, solid, places[0, chosen]) for scene in scenes])
        if chosen.any() and np.abs(way - way[:1]).max() > STATIC_PIXELS * pixel:
            off = [_distance(scene, solid, now) for scene, now in zip(scenes, places[:, chosen], strict=True)]
            columns.append(np.stack(off) < OFF * pixel)
    return np.concatenate(columns, axis=1)


def _pose(scene: Shapes, solid: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the center [3], half extents [3] and rotation [3, 3] of a solid."""
    row = scene.solids[solid]
    return row[POSITION:HALF], row[HALF:ROTATION], row[ROTATION : ROTATION + 9].reshape(3, 3)


def _distance(scene: Shapes, solid: int, places: np.ndarray) -> np.ndarray:
    """Return the distance from the box around a solid, [N]."""
    middle, half, turn = _pose(scene, solid)
    return np.linalg.norm(np.maximum(np.abs((places - middle) @ turn) - half, 0), axis=-1)


def _carried(before: Shapes, after: Shapes, solid: int, places: np.ndarray) -> np.ndarray:
    """Return positions [N, 3] on a solid after it has moved."""
    (middle, _, turn), (there, _, turned) = _pose(before, solid), _pose(after, solid)
    return (places - middle) @ turn @ turned.T + there


if __name__ == "__main__":
    tyro.cli(main)
