"""Points as tensors on a device, without their colors."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from splatreel.scene.gaussians import Gaussians


class SplatTensors(NamedTuple):
    """means and scales [N, 3], quats [N, 4], opacities [N]."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor

    @classmethod
    def of(cls, points: Gaussians, device: torch.device | str = "cpu") -> SplatTensors:
        """Points on a device; on the CPU they share memory."""
        arrays = (points.means, points.quats, points.scales, points.opacities)
        return cls(*(torch.from_numpy(array).to(device) for array in arrays))
