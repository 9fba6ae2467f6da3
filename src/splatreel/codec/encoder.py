"""Encoding of layers and groups in every rendition, without writing. Threads and other machines can therefore do it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from splatreel.codec.group_file import encode_group, encode_layer, encode_layer_again
from splatreel.codec.predictive.precision import SHAPE, STEPS, Steps, choose_precision
from splatreel.config import EncodeConfig
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

FIRST = 5000
"""Points of the first part, about 80 KB. Layers of at most twice as many points have one part."""
GROWTH = 4
"""Size of a part relative to the part before. The last part is a half to twice as large."""
_RADIUS = 3.0
"""Standard deviations within which a splat is visible."""


def part_sizes(count: int) -> list[int]:
    """Return the number of points of each part of a layer of `count` points."""
    sizes, size = [], FIRST
    while count > 2 * size:
        sizes.append(size)
        count -= size
        size *= GROWTH
    return [*sizes, count]


def split_layer(gaussians: Gaussians, classes: np.ndarray, cameras: Sequence[Camera]) -> list[np.ndarray]:
    """Return the indices of the points of each part, the parts of most visible points first.

    Large opaque points come first, so that the first part alone covers the image. Unimportant points, such as hidden
    ones, come last. Within a part points keep their order.

    Args:
        gaussians: Points of the layer, N.
        classes: Classes of the points, [N, 3], see `classes_of`.
        cameras: Cameras in which areas are measured. Without any, areas are those in the world.
    """
    sizes = part_sizes(len(gaussians))
    visibility = gaussians.opacities * _areas(gaussians, cameras) * 4.0 ** -classes[:, SHAPE]
    # Equal points are in one part, whatever their order.
    ranks = np.searchsorted(np.sort(-visibility), -visibility)
    parts = np.searchsorted(np.cumsum(sizes), ranks, side="right")
    return [some for part in range(len(sizes)) if len(some := np.flatnonzero(parts == part))]


def _areas(gaussians: Gaussians, cameras: Sequence[Camera]) -> np.ndarray:
    """Return the mean area of each splat in the images, [N], in pixels up to a factor.

    All arithmetic is element by element: a matrix product may round differently for points in another order.
    """
    _, middle, large = np.sort(gaussians.scales.astype(np.float64), axis=1).T
    if not cameras:
        return middle * large
    x, y, z = gaussians.means.astype(np.float64).T
    total = np.zeros(len(gaussians))
    for camera in cameras:
        rows, width, height = camera.viewmat.astype(np.float64), camera.width, camera.height
        right, down, depth = (row[0] * x + row[1] * y + row[2] * z + row[3] for row in rows[:3])
        (fx, _, cx), (_, fy, cy), _ = camera.K.astype(np.float64).tolist()
        near = np.where(depth > 0, depth, np.inf)
        u, v = fx * right / near + cx, fy * down / near + cy
        reach = _RADIUS * max(fx, fy) * large / near
        inside = (depth > 0) & (u > -reach) & (u < width + reach) & (v > -reach) & (v < height + reach)
        total += np.where(inside, np.minimum(fx * fy * middle * large / near**2, width * height), 0)
    return total / len(cameras)


EncodedLayer = tuple[tuple[bytes, ...], np.ndarray]
"""The files of a layer's parts, and order [N]: order[i] is the index of the input point that became point i of these files."""


class ReelEncoder:
    """Encoder of layer and group files.

    Args:
        config: Settings. With renditions, every group is encoded in each of them, the best first.
        cameras: Cameras of the capture, by which the points of a layer's first part are chosen.

    Attributes:
        config: Settings of the best rendition, which layers use.
    """

    def __init__(self, config: EncodeConfig, cameras: Sequence[Camera] = ()) -> None:
        first, *others = config.renditions or (None,)
        self.config = config if first is None else config.rendition(first)
        self._cameras = cameras
        self._others = {name: config.rendition(name) for name in others}

    @property
    def others(self) -> tuple[str, ...]:
        """Names of the renditions after the best."""
        return tuple(self._others)

    def layer(
        self,
        group: int,
        first_frame: int,
        gaussians: Gaussians,
        importance: np.ndarray | None = None,
        steps: Steps = STEPS,
    ) -> EncodedLayer:
        """Encode the static points born at a group. A large layer has several parts (`split_layer`).

        Args:
            group: Number of the group.
            first_frame: First frame of the group.
            gaussians: Static points.
            importance: Effect of each point's shape, color and position on the images, [N, 3]; None weighs all points
                equally.
            steps: Quantization steps of the predictive codec at a coarseness of 1.

        Returns:
            The files of the parts, and order [N]: order[i] is the index of the input point that became reel point i.
        """
        config = self.config
        if config.codec != "predictive" or len(part_sizes(len(gaussians))) == 1:
            file, order = encode_layer(group, first_frame, gaussians, config, importance, steps)
            return (file,), order
        precision = choose_precision(gaussians.scales, importance, config.coarseness, False, steps)
        precision = replace(precision, low=gaussians.means.min(0).astype(np.float64))  # the parts share a grid
        parts = split_layer(gaussians, precision.classes, self._cameras)
        encoded = [
            encode_layer_again(group, first_frame, gaussians[part], precision[part], config.sh_entries != 0)
            for part in parts
        ]
        order = np.concatenate([part[order] for part, (_, order) in zip(parts, encoded, strict=True)])
        return tuple(file for file, _ in encoded), order

    def group(self, group: Group, importance: np.ndarray | None = None, steps: Steps = STEPS) -> dict[str, bytes]:
        """Encode a group in every rendition. Return the files by URI, the best first."""
        name = f"groups/{group.index:04d}"
        configs = {f"{name}.safetensors": self.config} | {f"{name}.{n}.safetensors": c for n, c in self._others.items()}
        return {uri: encode_group(group, c, importance, steps)[0] for uri, c in configs.items()}
