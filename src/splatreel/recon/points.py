"""Trainable Gaussians: leaf tensors, their optimiser, and row surgery that keeps the two together."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from splatreel.scene.gaussians import Gaussians

NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh_base", "sh_rest")


class TrainablePoints:
    """Gaussians as unconstrained leaf tensors with one Adam optimiser over all of them.

    params: means [N, 3], quats [N, 4], log_scales [N, 3], logit_opacities [N], sh_base [N, 1, 3], sh_rest [N, K - 1, 3].
    Learning rates are per attribute; `means` is in world units.
    """

    def __init__(self, params: Mapping[str, Tensor], rates: Mapping[str, float]) -> None:
        self.params = {name: params[name].detach().clone().contiguous().requires_grad_(True) for name in NAMES}
        self.base_rates = dict(rates)
        device = self.params["means"].device
        self.optimizer = torch.optim.Adam(
            [{"params": [self.params[name]], "lr": rates[name], "name": name} for name in NAMES],
            eps=1e-15,
            fused=device.type in ("cpu", "cuda"),
        )

    @staticmethod
    def from_gaussians(gaussians: Gaussians, rates: Mapping[str, float], device: torch.device) -> TrainablePoints:
        return TrainablePoints(to_params(gaussians, device), rates)

    def __len__(self) -> int:
        return len(self.params["means"])

    @property
    def means(self) -> Tensor:
        return self.params["means"]

    @property
    def quats(self) -> Tensor:
        return self.params["quats"]

    @property
    def scales(self) -> Tensor:
        return self.params["log_scales"].exp()

    @property
    def opacities(self) -> Tensor:
        return self.params["logit_opacities"].sigmoid()

    @property
    def sh(self) -> tuple[Tensor, Tensor]:
        """The colour's constant part [N, 1, 3] and its higher bands [N, K - 1, 3]."""
        return self.params["sh_base"], self.params["sh_rest"]

    def scale_rates(self, factors: Mapping[str, float], default: float = 1.0) -> None:
        """Set every learning rate to its base rate times a factor."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.base_rates[group["name"]] * factors.get(group["name"], default)

    def step(self) -> None:
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)

    def keep(self, index: Tensor) -> None:
        """Keep the rows that an index or mask selects, in its order, with their optimiser state."""
        self._rewrite(lambda tensor: tensor[index], lambda state: state[index])

    def append(self, params: Mapping[str, Tensor]) -> None:
        """Add rows; their optimiser state starts at zero."""
        rows = {name: params[name].detach() for name in NAMES}
        for group in self.optimizer.param_groups:
            new = rows[group["name"]]
            self._replace(
                group, lambda t, new=new: torch.cat([t, new]), lambda s, new=new: torch.cat([s, torch.zeros_like(new)])
            )

    def rows(self, index: Tensor) -> dict[str, Tensor]:
        """Copies of the rows that an index or mask selects."""
        return {name: tensor.detach()[index].clone() for name, tensor in self.params.items()}

    def gaussians(self) -> Gaussians:
        """The points as plain activated arrays."""
        return to_gaussians(self.params)

    def _rewrite(self, of_tensor, of_state) -> None:
        for group in self.optimizer.param_groups:
            self._replace(group, of_tensor, of_state)

    def _replace(self, group, of_tensor, of_state) -> None:
        old = group["params"][0]
        state = self.optimizer.state.pop(old, None)
        new = of_tensor(old.detach()).contiguous().requires_grad_(True)
        group["params"] = [new]
        self.params[group["name"]] = new
        if state:
            state["exp_avg"] = of_state(state["exp_avg"]).contiguous()
            state["exp_avg_sq"] = of_state(state["exp_avg_sq"]).contiguous()
            self.optimizer.state[new] = state


def to_params(gaussians: Gaussians, device: torch.device) -> dict[str, Tensor]:
    """Unconstrained tensors of plain Gaussians."""
    opacities = np.clip(gaussians.opacities, 1e-4, 1 - 1e-4)
    arrays = {
        "means": gaussians.means,
        "quats": gaussians.quats,
        "log_scales": np.log(np.maximum(gaussians.scales, 1e-9)),
        "logit_opacities": np.log(opacities / (1 - opacities)),
        "sh_base": gaussians.sh[:, :1],
        "sh_rest": gaussians.sh[:, 1:],
    }
    return {name: torch.from_numpy(np.array(value, np.float32)).to(device) for name, value in arrays.items()}


def to_gaussians(params: Mapping[str, Tensor]) -> Gaussians:
    """Plain activated Gaussians of unconstrained tensors."""
    p = {name: tensor.detach().cpu() for name, tensor in params.items()}
    return Gaussians(
        p["means"].numpy(),
        torch.nn.functional.normalize(p["quats"], dim=-1).numpy(),
        p["log_scales"].exp().numpy(),
        p["logit_opacities"].sigmoid().numpy(),
        torch.cat([p["sh_base"], p["sh_rest"]], 1).numpy(),
    )


def default_rates(unit: float, pace: float = 1.0) -> dict[str, float]:
    """Learning rates of 3DGS times a pace, positions relative to `unit`, the typical viewing distance in world units.

    The higher SH bands keep theirs: at a faster pace they learn the training cameras by heart.
    """
    return {
        "means": pace * 2.2e-4 * unit,
        "quats": pace * 2e-3,
        "log_scales": pace * 7e-3,
        "logit_opacities": pace * 3e-2,
        "sh_base": pace * 4e-3,
        "sh_rest": 2e-4,
    }
