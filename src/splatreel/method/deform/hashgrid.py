"""Deformation model `hashgrid` of the paper: a 4D hash grid decoded by small MLPs (paper section 4.2, after Grid4D).

Four multiresolution hash grids are used: one in space (xyz) and three in space-time (xyt, xzt, yzt, coarser along t). As in
Grid4D, the spatial feature gates the space-time features by a factor in -1..1. Without the gate, neighboring points drift
apart.
"""

from __future__ import annotations

import copy

import numpy as np
import torch
from torch import Tensor, nn

from splatreel.kernels import motion, splat
from splatreel.method.deform.knot_adam import Restore
from splatreel.method.deform.protocol import movable, movable_with
from splatreel.method.deform.spline import Spline

AXES = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
TIME_SPAN = 0.9
"""Share of the unit interval that a group's time spans."""


class HashGrid(nn.Module):
    """Hash grid model, see `Deformation`.

    Tracks are kept as splines of the points, [knots, N, 3], and the grid learns the remainder. A grid fitted to the tracks
    would couple objects that pass close to each other, since they share cells.
    """

    LEVELS = 12
    FEATURES = 2
    LOG2_ENTRIES = 15
    SPATIAL_RESOLUTIONS = (16, 512)
    SPACE_TIME_RESOLUTIONS = ((8, 128), (4, 24))
    """Coarsest and finest resolution, of the two space axes and of time."""
    WIDTH = 64
    GRID_RATE, NETWORK_RATE = 4e-3, 1e-3
    low: Tensor
    extent: Tensor

    def __init__(
        self,
        means: Tensor,
        frames: int,
        unit: float,
        seed: int = 0,
        tracks: Tensor | None = None,
        fixed: Tensor | None = None,
    ) -> None:
        """Create a model.

        Args:
            means: [N, 3] canonical positions.
            frames: Number of frames, T.
            unit: Typical viewing distance, world units. The network's output is in a tenth of it.
            seed: Seed of the initial values.
            tracks: [T, N, 3] initial positions; None is at rest.
            fixed: [N] bool, points that never move; None for none.
        """
        super().__init__()
        self.moves = movable(means, fixed)
        generator = torch.Generator().manual_seed(seed)
        paths = None if tracks is None else tracks - means
        self.spline = Spline(frames) if paths is None else Spline.along(paths)
        self.tracks = None if paths is None else self.spline.fit(paths)
        self.unit = unit
        low, high = means.amin(0), means.amax(0)
        margin = 0.1 * unit
        self.register_buffer("low", low - margin)
        self.register_buffer("extent", (high - low + 2 * margin).max())
        space = _geometric(*self.SPATIAL_RESOLUTIONS, self.LEVELS)
        plane, time = (_geometric(*r, self.LEVELS) for r in self.SPACE_TIME_RESOLUTIONS)
        self.resolutions = [
            np.stack([space] * 3, 1) if 3 not in axes else np.stack([plane, plane, time], 1) for axes in AXES
        ]
        shape = (self.LEVELS, 2**self.LOG2_ENTRIES, self.FEATURES)
        self.tables = nn.ParameterList(
            nn.Parameter((torch.rand(shape, generator=generator) * 2 - 1).mul_(1e-4).to(means.device)) for _ in AXES
        )
        features = self.LEVELS * self.FEATURES
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.gate = nn.Linear(features, self.WIDTH)
            self.motion = nn.Sequential(nn.Linear(3 * features, self.WIDTH), nn.ReLU())
            self.heads = nn.ModuleList([_head(self.WIDTH, 3), _head(self.WIDTH, 4)])
        self.to(means.device)
        with torch.no_grad():
            self.gate.bias.fill_(1.0)
        networks = [*self.gate.parameters(), *self.motion.parameters(), *self.heads.parameters()]
        self.optimizer = torch.optim.Adam(
            [
                {"params": list(self.tables), "lr": self.GRID_RATE, "base": self.GRID_RATE},
                {"params": networks, "lr": self.NETWORK_RATE, "base": self.NETWORK_RATE},
            ],
            eps=1e-15,
            fused=True,
        )

    def offsets(self, means: Tensor, frame: float) -> tuple[Tensor, Tensor]:
        """See `Deformation`."""
        # Positions are constants: a gradient through the grid would move the points to where the grid is smooth.
        space = ((means.detach() - self.low) / self.extent).clamp(0, 1 - 1e-6)
        time = torch.full_like(space[:, :1], frame / self.spline.last * TIME_SPAN)
        coordinates = torch.cat([space, time], 1)
        features = [
            motion.hashgrid(coordinates[:, list(axes)].contiguous(), table, resolutions)
            for axes, table, resolutions in zip(AXES, self.tables, self.resolutions, strict=True)
        ]
        gate = 2 * torch.sigmoid(self.gate(features[0])) - 1
        hidden = gate * self.motion(torch.cat(features[1:], 1))
        dx, dq = (head(hidden) for head in self.heads)
        identity = torch.tensor([1.0, 0, 0, 0], device=dx.device)
        dx = dx * (0.1 * self.unit)
        if self.tracks is not None:
            knot, weights = self.spline.at(frame)
            known = torch.from_numpy(weights).to(dx.device) @ self.tracks[knot : knot + 4].flatten(1)
            dx = dx + known.view(-1, 3)
        return dx * self.moves, dq * (0.1 * self.moves) + identity

    @torch.no_grad()
    def change(self, means: Tensor, span: tuple[float, float], offsets: tuple[Tensor, Tensor]) -> Tensor:
        """See `Deformation`."""
        before, after = (self.offsets(means, frame) for frame in span)
        parts = zip(before, after, offsets, strict=True)
        return torch.stack([((b - a) * at.grad).sum() for a, b, at in parts if at.grad is not None]).sum()

    def extend_to(self, frame: float) -> None:
        """Do nothing: the grid is defined at all times."""

    def step(self, share: float, pace: float = 1.0) -> None:
        """See `Deformation`."""
        for group in self.optimizer.param_groups:
            group["lr"] = pace * group["base"] * 0.02**share
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)

    def snapshot(self) -> Restore:
        """See `Deformation`."""
        values, moments = copy.deepcopy(self.state_dict()), copy.deepcopy(self.optimizer.state_dict())
        moves, tracks = self.moves, self.tracks  # replaced, never changed in place

        def restore() -> None:
            self.load_state_dict(values)
            self.optimizer.load_state_dict(copy.deepcopy(moments))
            self.optimizer.zero_grad(set_to_none=True)
            self.moves = moves
            self.tracks = tracks

        return restore

    def check(self) -> None:
        """See `Deformation`."""
        splat.check_finite(**dict(self.named_parameters()))

    def keep(self, index: Tensor) -> None:
        """See `Deformation`."""
        self.moves = self.moves[index]
        if self.tracks is not None:
            self.tracks = self.tracks[:, index]

    def append(self, means: Tensor, parents: Tensor | None) -> None:
        """Add points. Copies take the tracks of their parents; new points have none, and move with the grid."""
        moves = movable_with(self.moves, means, parents)
        self.moves = torch.cat([self.moves, moves])
        if self.tracks is not None:
            zeros = self.tracks.new_zeros(len(self.tracks), len(means), 3)
            added = zeros if parents is None else self.tracks[:, parents]
            self.tracks = torch.cat([self.tracks, added], 1)


def _head(width: int, outputs: int) -> nn.Sequential:
    head = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, outputs))
    last = head[-1]
    assert isinstance(last, nn.Linear)
    nn.init.normal_(last.weight, std=1e-2)
    nn.init.zeros_(last.bias)
    return head


def _geometric(low: int, high: int, levels: int) -> np.ndarray:
    return np.floor(low * (high / low) ** (np.arange(levels) / max(levels - 1, 1))).astype(np.int64)
