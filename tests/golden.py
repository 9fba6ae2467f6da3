"""The golden reels: tiny reels, one a codec, that the Python and the TypeScript decoder both turn into the same numbers.

`python -m tests.golden` makes tests/data/golden (h265), tests/data/golden-predictive and tests/data/golden-sound (`tests/flashes.py`)
anew, those of version 2 (`tests/golden_long.py`), and the conformance suite (`tests/conformance_cases.py`): do it only when the
format changes.

    manifest.json, layers/, groups/     the reel: 2 groups of 6 frames, overlap 2, static points born at both
    expected.npz                        every decoded array
    expected.json                       these and what is shown at `TIMES`, sampled, for tests in any language

Floats agree within `TOLERANCE` (relative to 1 or the value, whichever is larger); integers and bits exactly.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Literal

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.reader import ReelReader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig, Rate
from splatreel.play.timeline import Timeline
from splatreel.scene import rotations
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from tests import flashes

GOLDEN = Path(__file__).parent / "data" / "golden"
PREDICTIVE = Path(__file__).parent / "data" / "golden-predictive"
TIMES = (0.0, 0.05, 0.1, 0.2, 0.225, 0.25, 0.3, 0.43, 9.0)
TOLERANCE = 1e-5
FPS = 30


def random_gaussians(
    rng: np.random.Generator, count: int, degree: int, center: tuple[float, float, float]
) -> Gaussians:
    """Return points on a bumpy sphere with sizes over three decades."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    means = np.array(center) + direction * (1 + 0.05 * rng.normal(size=(count, 1)))
    sh = rng.normal(size=(count, (degree + 1) ** 2, 3)) * np.r_[0.8, np.full((degree + 1) ** 2 - 1, 0.08)][:, None]
    return Gaussians(
        means=means,
        quats=rotations.normalize(rng.normal(size=(count, 4))),
        scales=10 ** rng.uniform(-3, -0.5, (count, 3)),
        opacities=rng.beta(2, 1, count),
        sh=sh,
    )


def random_motion(rng: np.random.Generator, points: Gaussians, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return dx [T, N, 3] and dq [T, N, 4]: a rotation about a random axis, a drift, and a little individual motion."""
    time = np.linspace(0, 1, frames)[:, None, None]
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angle = 0.6 * time + 0.02 * rng.normal(size=(1, len(points), 1)) * time
    dq = np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * axis], -1)
    turned = np.einsum("tnij,nj->tni", rotations.to_matrix(dq), points.means)
    return turned - points.means + time * rng.normal(size=3) * 0.3, dq


def random_shade(rng: np.random.Generator, count: int, frames: int) -> np.ndarray:
    """Return [T, N, 4]: a light that passes over the points, each in its own color, and points that fade."""
    passing = np.sin(np.linspace(0, 3, frames))[:, None, None]
    return (passing * rng.normal(size=(1, count, 4)) * [0.5, 0.5, 0.5, 0.3]).astype(np.float32)


def weights(count: int) -> np.ndarray:
    """Return importance [count, 3] over four octaves."""
    return 2.0 ** -(np.arange(3 * count).reshape(count, 3) % 5)


def camera(name: str, x: float) -> Camera:
    viewmat = np.eye(4)
    viewmat[:3, 3] = (-x, 0, 4)
    return Camera(name, viewmat, np.array([[120, 0, 80], [0, 120, 60], [0, 0, 1]]), 160, 120)


def write_golden(path: Path, codec: Literal["predictive", "h265"] = "h265", renditions: tuple[Rate, ...] = ()) -> None:
    """Write a golden reel: layers of degree 3 and 2, dynamic points of degree 1, the second group with shade.

    The predictive reel is drawn with `antialias`, and its second group becomes darker and redder.
    """
    rng = np.random.default_rng(4)
    if path.exists():
        shutil.rmtree(path)
    header = ReelHeader(
        fps=FPS,
        group_length=6,
        overlap=2,
        sh_degree=3,
        bounds=np.array([[-1.5, -1.5, -1.5], [1.5, 1.5, 1.5]]),
        up=np.array([0.0, -1.0, 0.0]),
        camera=camera("start", 0.0),
        cameras=[camera("cam00", -0.5), camera("cam01", 0.5)],
        antialias=codec == "predictive",
    )
    writer = ReelWriter(path, header, config=EncodeConfig(codec=codec, coarseness=1.0, renditions=renditions))
    alive = np.ones(0, bool)
    for index, (born, moving, frames) in enumerate(((150, 100, 8), (50, 90, 8))):
        layer, _ = writer.add_layer(index, index * 6, random_gaussians(rng, born, 3 - index, (0, 0, 0)), weights(born))
        alive = np.concatenate([alive & (rng.random(len(alive)) > 0.3), np.ones(len(layer), bool)])
        dynamic = random_gaussians(rng, moving, 1, (0.5, 0.2, 0))
        dx, dq = random_motion(rng, dynamic, frames)
        shade = random_shade(rng, moving, frames) if index else None
        dusk = np.geomspace((1.0, 1.0, 1.0), (0.8, 0.5, 0.4), frames, dtype=np.float32)
        light = dusk if index and codec == "predictive" else None
        writer.add_group(Group(index, index * 6, dynamic, dx, dq, alive, shade, light), weights(moving))
    writer.finish()


def decoded(path: Path, times: tuple[float, ...] = TIMES, rendition: str | None = None) -> dict[str, np.ndarray]:
    """Return every array of the reel by name: `layer0.means`, `group1.dynamic.sh`, `group1.dx`, `at0.05.opacities`, ...

    Layers are counted through the manifest and its pages. Groups have their own numbers.
    """
    reel = ReelReader(path, rendition)
    arrays: dict[str, np.ndarray] = {}
    for index in range(len(reel.manifest.layers)):
        arrays |= _flat(f"layer{index}", reel.layer(index))
    for index in (entry.group for entry in reel.manifest.groups):
        group = reel.group(index)
        arrays |= _flat(f"group{index}.dynamic", group.dynamic)
        arrays |= {f"group{index}.{name}": getattr(group, name) for name in ("dx", "dq", "alive")}
        changes = {f"group{index}.{name}": getattr(group, name) for name in ("shade", "light")}
        arrays |= {name: change for name, change in changes.items() if change is not None}
    for time in times:
        arrays |= _flat(f"at{time:g}", Timeline(reel).at(time))
    return arrays


def sampled(arrays: dict[str, np.ndarray], values: int = 48, times: tuple[float, ...] = TIMES) -> dict:
    """Return for each array its shape and at most `values` numbers: positions in the flat array, and values there."""
    entries = {}
    for name, array in arrays.items():
        flat = array.ravel()
        where = (
            np.unique(np.linspace(0, flat.size - 1, min(values, flat.size)).round().astype(int)) if flat.size else []
        )
        picked = [int(flat[i]) if array.dtype == bool else float(flat[i]) for i in where]
        entries[name] = {"shape": list(array.shape), "index": [int(i) for i in where], "value": picked}
    return {"tolerance": TOLERANCE, "times": list(times), "arrays": entries}


def _flat(prefix: str, gaussians: Gaussians) -> dict[str, np.ndarray]:
    return {f"{prefix}.{name}": getattr(gaussians, name) for name in Gaussians.ARRAYS}


def main() -> None:
    from tests import conformance_cases, golden_long  # they need this module

    golden_long.write_all()
    conformance_cases.write_all()
    flashes.write_golden(flashes.GOLDEN)
    codecs: dict[Path, Literal["h265", "predictive"]] = {GOLDEN: "h265", PREDICTIVE: "predictive"}
    for path, codec in codecs.items():
        write_golden(path, codec)
        arrays = decoded(path)
        stored = {name: array for name, array in arrays.items() if not name.startswith("at")}
        np.savez_compressed(path / "expected.npz", **stored)  # pyright: ignore[reportArgumentType]
        (path / "expected.json").write_text(json.dumps(sampled(arrays), indent=None, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
