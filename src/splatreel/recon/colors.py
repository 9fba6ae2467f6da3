"""Per-camera colour gain, learned with the scene and anchored at a mean of one."""

from __future__ import annotations

import torch
from torch import Tensor


class CameraGains:
    """One gain a camera and channel; the mean over cameras is held at one, so that a camera never seen needs none.

    Real rigs differ by several percent between cameras. Without gains the scene averages them and every view is wrong.
    """

    def __init__(self, cameras: int, device: torch.device, enabled: bool = True, rate: float = 2e-3) -> None:
        self.values = torch.ones(cameras, 3, device=device, requires_grad=enabled)
        self.enabled = enabled
        self._rate = rate
        self.restart()

    def restart(self) -> None:
        """Forget the optimiser's momentum: a run continued from a checkpoint goes on as one that was never stopped."""
        self._optimizer = torch.optim.Adam([self.values], lr=self._rate) if self.enabled else None

    def of(self, camera: int) -> Tensor | None:
        """[3]: what a rendered picture is multiplied by to be as the camera would record it; None if they are off."""
        return self.values[camera] if self.enabled else None

    def step(self) -> None:
        if self._optimizer is None:
            return
        self._optimizer.step()
        self._optimizer.zero_grad(set_to_none=True)
        with torch.no_grad():
            self.values /= self.values.mean(0)

    def load(self, values: Tensor) -> None:
        with torch.no_grad():
            self.values.copy_(values)
