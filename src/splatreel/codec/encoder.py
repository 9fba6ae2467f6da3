"""Encoding of layers and groups in every rendition, without writing. Threads and other machines can therefore do it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from splatreel.codec.group_file import encode_group, encode_layer, encode_layer_again
from splatreel.codec.layer_parts import part_sizes, split_layer
from splatreel.codec.predictive.precision import STEPS, Steps, choose_precision
from splatreel.config import EncodeConfig
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

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
        """Encode the static points born at a group. A large layer has several parts (`layer_parts`).

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
