"""Color gains of the cameras, learned with the scene, with a mean of one."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from splatreel.kernels import adam
from splatreel.method.deform.knot_adam import Adam, Restore


class CameraGains:
    """One gain for each camera and color channel. The mean over the cameras stays one, so that a camera that was never seen needs none.

    Real cameras differ by several percent. Without gains the scene averages them, and every view is wrong.

    Args:
        cameras: Number of cameras.
        device: Device of the gains.
        enabled: False keeps all gains at one.
        rate: Learning rate.

    Attributes:
        adam: Optimizer of the gains.
    """

    def __init__(self, cameras: int, device: torch.device, enabled: bool = True, rate: float = 2e-3) -> None:
        """Start with gains of one."""
        self.enabled = enabled
        self._start(torch.ones(cameras, 3, device=device), rate)

    def _start(self, values: Tensor, rate: float) -> None:
        self.adam = Adam(values, rate, eps=1e-8)
        self._seen: list[tuple[int, Tensor]] = []

    @property
    def values(self) -> Tensor:
        """Gains [cameras, 3], without a gradient."""
        return self.adam.tensor.detach()

    def restart(self) -> None:
        """Forget the optimizer's momentum, as a run that is continued from a checkpoint does."""
        self._start(self.values, self.adam.rate)

    def of(self, camera: int) -> Tensor | None:
        """Return the gain [3] that a rendered image is multiplied by to match a camera's colors; None if gains are off.

        The gain is a leaf tensor. The next step follows its gradient.
        """
        if not self.enabled:
            return None
        gain = self.values[camera].clone().requires_grad_()
        self._seen.append((camera, gain))
        return gain

    def step(self) -> None:
        """Make one optimizer step with the gradients of all gains that were handed out since the last one."""
        known = [(camera, gain.grad) for camera, gain in self._seen if gain.grad is not None]
        self._seen.clear()
        if not known:
            return
        self.follow(known)

    def follow(self, known: Iterable[tuple[int, Tensor]]) -> None:
        """Make one optimizer step. known: cameras, and the gradients [3] to their gains."""
        gradient = torch.zeros_like(self.values)
        for camera, slope in known:
            gradient[camera] += slope
        adam.adam([self.adam.follow(gradient, 0)])
        self.values.div_(self.values.mean(0))

    def snapshot(self) -> Restore:
        """Return a function that restores the gains and their optimizer."""
        gains = self.adam.snapshot()

        def restore() -> None:
            gains()
            self._seen.clear()

        return restore

    def load(self, values: Tensor) -> None:
        """Set the gains [cameras, 3]."""
        self.values.copy_(values)
