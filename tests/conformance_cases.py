"""The cases of the conformance suite (conformance/README.md); `python -m tests.golden` writes them anew, with the golden reels."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from conformance.run import HERE, arrays_of, describe

from splatreel.codec.reader import ReelReader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from tests.codec.reels import add_chapter_group, new_writer
from tests.golden import TOLERANCE, random_gaussians, random_motion, random_shade, weights

PREDICTIVE = EncodeConfig(coarseness=1.0)
PAPER = EncodeConfig(codec="h265", sh_entries=16)
SEVERAL = EncodeConfig(coarseness=1.0, renditions=("high", "low"))
LENGTH, OVERLAP = 4, 2


def write(
    path: Path,
    config: EncodeConfig = PREDICTIVE,
    born: tuple[int, ...] = (20, 0),
    moving: int = 12,
    degree: int = 1,
    change: str = "",
    importance: bool = False,
    overlaps: tuple[int, ...] = (),
) -> None:
    """Write a reel of groups of 4 frames that overlap by 2.

    Args:
        path: Folder of the reel.
        config: Settings of the codec.
        born: Number of static points born at each group. In each later group a third of the older ones is not alive.
        moving: Number of dynamic points of a group.
        degree: SH degree of all points.
        change: "shade" or "light", which change in the last group.
        overlaps: Overlap of each group with the one before; that of the reel for those that are not given.
        importance: Give points different importance, so that they get different quantization steps.
    """
    rng = np.random.default_rng(5)
    writer = new_writer(path, config=config, group_length=LENGTH, overlap=OVERLAP, sh_degree=degree)
    alive = np.ones(0, bool)
    for index, count in enumerate(born):
        layer = random_gaussians(rng, count, degree, (0, 0, 0))
        writer.add_layer(index, index * LENGTH, layer, weights(count) if importance else None)
        alive = np.concatenate([alive & (rng.random(len(alive)) > 0.3), np.ones(count, bool)])
        last = index == len(born) - 1
        group = moving_group(rng, index, moving, degree, alive, change if last else "")
        overlap = overlaps[index] if index < len(overlaps) else None
        writer.add_group(group, weights(moving) if importance else None, overlap=overlap)
    writer.finish()


def moving_group(
    rng: np.random.Generator, index: int, count: int, degree: int, alive: np.ndarray, change: str
) -> Group:
    """Return a group of random points that rotate and drift."""
    frames = LENGTH + OVERLAP
    points = random_gaussians(rng, count, degree, (0.5, 0.2, 0)) if count else Gaussians.empty(degree)
    dx, dq = random_motion(rng, points, frames) if count else (np.zeros((frames, 0, 3)), np.zeros((frames, 0, 4)))
    dusk = np.geomspace((1.0, 1.0, 1.0), (0.8, 0.5, 0.4), frames, dtype=np.float32)
    shade = random_shade(rng, count, frames) if change == "shade" else None
    return Group(index, index * LENGTH, points, dx, dq, alive, shade, dusk if change == "light" else None)


def write_parts(path: Path) -> None:
    """Write a layer in two parts, and a group at which some of its points are not alive."""
    rng = np.random.default_rng(5)
    writer = new_writer(path, config=PREDICTIVE, group_length=LENGTH, overlap=OVERLAP)
    for count in (8, 20):
        writer.add_layer(0, 0, random_gaussians(rng, count, 1, (0, 0, 0)))
    for index, alive in enumerate((np.ones(28, bool), np.arange(28) % 3 > 0)):
        writer.add_group(moving_group(rng, index, 12, 1, alive, ""))
    writer.finish()


def write_chapters(path: Path, groups: int, page: int = 64, keep: int | None = None) -> ReelWriter:
    """Write a reel in chapters of three groups, whose layers are retired. keep: drop the groups before this one, and stay live."""
    writer = new_writer(path, config=PREDICTIVE, page=page)
    for index in range(groups):
        add_chapter_group(writer, index, 3)
    if keep is None:
        writer.finish()
    else:
        writer.drop_before(keep)
    return writer


CASES: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "predictive": ("static and dynamic points in the predictive codec", lambda path: write(path, born=(20,))),
    "classes": ("quantization steps that differ from point to point", lambda path: write(path, importance=True)),
    "paper": ("Draco, a codebook of colors and H.265", lambda path: write(path, PAPER)),
    "paper-shade": ("changing colors beside H.265", lambda path: write(path, PAPER, change="shade")),
    "sh-0": ("spherical harmonics of degree 0", lambda path: write(path, born=(20,), degree=0)),
    "sh-2": ("spherical harmonics of degree 2", lambda path: write(path, born=(20,), degree=2)),
    "sh-3": ("spherical harmonics of degree 3", lambda path: write(path, born=(20,), degree=3)),
    "cross-fade": ("two groups that overlap", lambda path: write(path, born=(20, 0))),
    "overlaps": (
        "groups with an overlap of their own: a hard cut, and a shorter cross-fade",
        lambda path: write(path, born=(20, 0, 0), overlaps=(0, 0, 1)),
    ),
    "layers": (
        "layers born at several groups, and static points that are not alive",
        lambda path: write(path, born=(20, 8, 0, 6)),
    ),
    "shade": ("colors and opacities that change", lambda path: write(path, change="shade")),
    "light": ("light that changes", lambda path: write(path, change="light")),
    "static": ("groups without dynamic points", lambda path: write(path, moving=0)),
    "dynamic": ("groups without static points", lambda path: write(path, born=(0, 0))),
    "renditions": ("two renditions of each group", lambda path: write(path, SEVERAL)),
    "parts": ("version 2: a layer in two parts", write_parts),
    "retired": ("version 2: layers that are retired, several born at one group", lambda path: write_chapters(path, 5)),
    "pages": ("version 2: a manifest in pages", lambda path: write_chapters(path, 7, page=2)),
    "window": (
        "version 2: a live reel that has dropped its first groups",
        lambda path: write_chapters(path, 7, page=2, keep=4),
    ),
}


def write_case(name: str, folder: Path) -> None:
    """Write the reel and the expectations of a case."""
    shutil.rmtree(folder, ignore_errors=True)
    CASES[name][1](folder)
    reel = ReelReader(folder)
    renditions = list(reel.manifest.renditions)
    last, fps = reel.frames, reel.fps
    times = sorted({round(frame / fps, 4) for frame in (0.5, LENGTH, LENGTH + 1.25, last - 1)} | {99.0})
    arrays = arrays_of(folder, times, renditions)
    slack = {name: allowance(name, arrays) for name in arrays}
    entries = {
        name: describe(array) | ({"display": slack[name]} if slack[name] else {}) for name, array in arrays.items()
    }
    found = {"times": times, "renditions": renditions, "tolerance": TOLERANCE, "arrays": entries}
    (folder / "expected.json").write_text(json.dumps(found, separators=(",", ":")) + "\n")


def allowance(name: str, arrays: dict[str, np.ndarray]) -> float:
    """Return the additional error of a decoder that stores offsets in 16 bits, and rotations and changes of color in 8 bits."""
    rendition, _, local = name.rpartition(":")
    field = local.rpartition(".")[2]
    coded = {"dx": ("dx", 65535), "means": ("dx", 65535), "dq": ("dq", 255), "quats": ("dq", 255)}
    coded |= {"shade": ("shade", 255), "opacities": ("shade", 255), "sh": ("shade", 255)}
    if field not in coded or not (local.startswith("at") or field in ("dx", "dq", "shade")):
        return 0.0
    source, levels = coded[field]
    found = [
        a for other, a in arrays.items() if other.startswith(rendition) and other.endswith(f".{source}") and a.size
    ]
    # Two steps: the quantized offset, and for rotations its neighbor in the product.
    return float(f"{2 * max((np.ptp(a) for a in found), default=0.0) / levels:.2g}")


def write_all() -> None:
    """Write all cases, and their list."""
    for name in CASES:
        write_case(name, HERE / name)
    text = json.dumps({name: covers for name, (covers, _) in CASES.items()}, indent=2)
    (HERE / "cases.json").write_text(text + "\n")


if __name__ == "__main__":
    write_all()
