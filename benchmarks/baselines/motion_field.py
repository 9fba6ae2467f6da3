"""Motion of all points from one frame to the next, as a small hash grid with a network: the cache of 3DGStream."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from splatreel.kernels import motion, splat


class MotionField(nn.Module):
    """Offsets of position and rotation as a function of position. It starts as no motion.

    Source:
        3DGStream, section 4.1 (neural transformation cache), with fewer levels.
    """

    LEVELS, FEATURES, LOG2_ENTRIES = 8, 2, 13
    RESOLUTIONS = (8, 256)
    """Coarsest and finest number of cells along an axis."""
    WIDTH = 32
    GRID_PATH, NETWORK_PATH, MAX_RATE = 4.0, 2.0, 0.1
    """Learning rates times iterations, so that few iterations take large steps; and the largest rate."""
    REACH = 0.05
    """Unit of the network's output, in viewing distances."""
    low: Tensor
    extent: Tensor

    def __init__(self, means: Tensor, bounds: np.ndarray, unit: float, iterations: int, seed: int) -> None:
        """Create a field.

        Args:
            means: [N, 3] positions; only their device counts.
            bounds: Box [2, 3] of the scene that the grid covers. Points outside use the nearest cell.
            unit: Typical viewing distance, world units.
            iterations: Iterations of training.
            seed: Seed of the initial values.
        """
        super().__init__()
        self.unit = unit
        low, high = (torch.from_numpy(np.asarray(corner, np.float32)) for corner in bounds)
        self.register_buffer("low", low - 0.1 * unit)
        self.register_buffer("extent", (high - low).max() + 0.2 * unit)
        coarse, fine = self.RESOLUTIONS
        steps = np.arange(self.LEVELS) / (self.LEVELS - 1)
        self.cells = np.repeat(np.floor(coarse * (fine / coarse) ** steps).astype(np.int64)[:, None], 3, 1)
        generator = torch.Generator().manual_seed(seed)
        shape = (self.LEVELS, 2**self.LOG2_ENTRIES, self.FEATURES)
        self.table = nn.Parameter((torch.rand(shape, generator=generator) * 2 - 1).mul_(1e-2))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            hidden, last = nn.Linear(self.LEVELS * self.FEATURES, self.WIDTH), nn.Linear(self.WIDTH, 7)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.network = nn.Sequential(hidden, nn.ReLU(), last)
        self.to(means.device)
        grid, network = (min(path / max(iterations, 1), self.MAX_RATE) for path in (self.GRID_PATH, self.NETWORK_PATH))
        rates = ((self.table, grid), *((p, network) for p in self.network.parameters()))
        self.optimizer = torch.optim.Adam([{"params": [p], "lr": rate, "base": rate} for p, rate in rates], eps=1e-15)

    def offsets(self, means: Tensor) -> tuple[Tensor, Tensor]:
        """Return dx [N, 3], world units, and dq [N, 4], about the identity, of points at means [N, 3]."""
        places = ((means.detach() - self.low) / self.extent).clamp(0, 1 - 1e-6)
        found = self.network(motion.hashgrid(places.contiguous(), self.table, self.cells))
        identity = torch.tensor([1.0, 0, 0, 0], device=means.device)
        return found[:, :3] * (self.REACH * self.unit), 0.1 * found[:, 3:] + identity

    def step(self, share: float) -> None:
        """Follow the gradients and clear them. share: share of training that is over, 0..1."""
        for group in self.optimizer.param_groups:
            group["lr"] = group["base"] * 0.1**share
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)

    def check(self) -> None:
        """Raise `GaussiansError` if a value is NaN or infinite."""
        splat.check_finite(**dict(self.named_parameters()))
