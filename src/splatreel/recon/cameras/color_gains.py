"""Per-camera color gain, learned with the scene and anchored at a mean of one."""

from __future__ import annotations

import torch
from torch import Tensor

from splatreel.kernels import adam
from splatreel.recon.deform.adam import Adam, Restore


class CameraGains:
    """One gain a camera and channel; the mean over cameras is held at one, so that a camera never seen needs none.

    Real rigs differ by several percent between cameras. Without gains the scene averages them and every view is wrong.
    """

    def __init__(self, cameras: int, device: torch.device, enabled: bool = True, rate: float = 2e-3) -> None:
        self.enabled = enabled
        self._start(torch.ones(cameras, 3, device=device), rate)

    def _start(self, values: Tensor, rate: float) -> None:
        self._adam = Adam(values, rate, eps=1e-8)
        self._seen: list[tuple[int, Tensor]] = []

    @property
    def values(self) -> Tensor:
        """[cameras, 3], without a gradient."""
        return self._adam.tensor.detach()

    def restart(self) -> None:
        """Forget the optimizer's momentum: a run continued from a checkpoint goes on as one that was never stopped."""
        self._start(self.values, self._adam.rate)

    def of(self, camera: int) -> Tensor | None:
        """[3]: what a rendered picture is multiplied by to be as the camera would record it; None if they are off.

        A leaf, whose gradient the next step follows.
        """
        if not self.enabled:
            return None
        gain = self.values[camera].clone().requires_grad_()
        self._seen.append((camera, gain))
        return gain

    def step(self) -> None:
        known = [(camera, gain.grad) for camera, gain in self._seen if gain.grad is not None]
        self._seen.clear()
        if not known:
            return
        gradient = torch.zeros_like(self.values)
        for camera, slope in known:
            gradient[camera] += slope
        adam.adam([self._adam.follow(gradient, 0)])
        self.values.div_(self.values.mean(0))

    def snapshot(self) -> Restore:
        """The gains and their optimizer's state, copied."""
        gains = self._adam.snapshot()

        def restore() -> None:
            gains()
            self._seen.clear()

        return restore

    def load(self, values: Tensor) -> None:
        self.values.copy_(values)
