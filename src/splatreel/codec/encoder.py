"""The files of layers and groups, in every rendition. Nothing is written, so that threads and other machines can do it."""

from __future__ import annotations

import numpy as np

from splatreel.codec.group_file import encode_group, encode_layer
from splatreel.codec.predictive.precision import STEPS, Steps
from splatreel.config import EncodeConfig
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


class ReelEncoder:
    """What is in a reel's files. config: with renditions, every group is encoded in each of them, the best first.

    The attribute `config` is that of the best rendition, which layers have.
    """

    def __init__(self, config: EncodeConfig) -> None:
        first, *others = config.renditions or (None,)
        self.config = config if first is None else config.rendition(first)
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
    ) -> tuple[bytes, np.ndarray]:
        """The file of the static points born at `group`, and order [N]: order[i] is the index of the point that became reel point i.

        importance: [N, 3], how much of the pictures hangs on each point's shape, color and place; None: all alike. steps:
        quantization steps of the predictive codec at a coarseness of 1.
        """
        return encode_layer(group, first_frame, gaussians, self.config, importance, steps)

    def group(self, group: Group, importance: np.ndarray | None = None, steps: Steps = STEPS) -> dict[str, bytes]:
        """By uri the files of a group, the best first."""
        name = f"groups/{group.index:04d}"
        configs = {f"{name}.safetensors": self.config} | {f"{name}.{n}.safetensors": c for n, c in self._others.items()}
        return {uri: encode_group(group, c, importance, steps)[0] for uri, c in configs.items()}
