"""Encoding of layers and groups in every rendition, without writing. Threads and other machines can therefore do it."""

from __future__ import annotations

import numpy as np

from splatreel.codec.group_file import encode_group, encode_layer
from splatreel.codec.predictive.precision import STEPS, Steps
from splatreel.config import EncodeConfig
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


class ReelEncoder:
    """Encoder of layer and group files.

    Args:
        config: Settings. With renditions, every group is encoded in each of them, the best first.

    Attributes:
        config: Settings of the best rendition, which layers use.
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
        """Encode the static points born at a group.

        Args:
            group: Number of the group.
            first_frame: First frame of the group.
            gaussians: Static points.
            importance: Effect of each point's shape, color and position on the images, [N, 3]; None weighs all points
                equally.
            steps: Quantization steps of the predictive codec at a coarseness of 1.

        Returns:
            The file, and order [N]: order[i] is the index of the input point that became reel point i.
        """
        return encode_layer(group, first_frame, gaussians, self.config, importance, steps)

    def group(self, group: Group, importance: np.ndarray | None = None, steps: Steps = STEPS) -> dict[str, bytes]:
        """Encode a group in every rendition. Return the files by URI, the best first."""
        name = f"groups/{group.index:04d}"
        configs = {f"{name}.safetensors": self.config} | {f"{name}.{n}.safetensors": c for n, c in self._others.items()}
        return {uri: encode_group(group, c, importance, steps)[0] for uri, c in configs.items()}
