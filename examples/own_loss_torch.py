"""Train the motion of a group with a loss of your own, whose gradients PyTorch computes.

python examples/own_loss_torch.py --weight 0.5

This example needs PyTorch, which Splatreel itself does not: `pip install torch`. The loss compares the edges of the drawing and of the
training image. A loss gets and returns arrays, so any library can compute the gradients inside the function.
`examples/own_loss.py` does it in plain numpy.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
import tyro

import splatreel
from splatreel.training import group_trainer
from train_group import FRAMES, NEAR, film, make_cameras, random_points


def edges(weight: float) -> Callable[[Any], tuple[float, Mapping[str, np.ndarray]]]:
    """Return a loss: the mean absolute difference of the edges of both images."""

    def loss(seen: Any) -> tuple[float, Mapping[str, np.ndarray]]:
        image = torch.from_numpy(seen.image).requires_grad_()  # [H, W, 3], 0..1
        target = torch.from_numpy(seen.target).float() / 255
        down, across = (torch.diff(image - target, dim=dim).abs().mean() for dim in (0, 1))
        value = weight * (down + across)
        value.backward()
        assert image.grad is not None
        return value.item(), {"image": image.grad.numpy()}

    return loss


def main(weight: float = 0.5, iterations: int = 150) -> None:
    """Train a group.

    Args:
        weight: Weight of the loss.
        iterations: Iterations in total, at most 60 for each frame.
    """
    cameras = make_cameras()
    wall = random_points(400, [-3, -2, 0.9], [3, 2, 1.0], seed=0)
    ball = random_points(48, [-0.8, -0.6, -0.4], [0.2, 0.6, 0.2], seed=1)
    config = splatreel.preset("standard")
    group = replace(
        config.group, deformation="hashgrid", length=FRAMES, overlap=0, iterations_per_frame=60, coarse_share=0
    )
    config = replace(config, group=group)
    images = film(wall, ball, cameras)
    trainer = group_trainer(images, cameras, ball, wall, config, near=NEAR, losses=[edges(weight)], device="cpu")
    losses = []
    for iteration in range(min(iterations, trainer.iterations)):
        losses.append(trainer.step(iteration))
        if len(losses) % 50 == 0:
            print(f"iteration {len(losses)}: photometric loss {np.mean(losses[-50:]):.4f}")
    moved = trainer.result().dx[-1, :, 0].mean()
    print(f"The ball moved by {moved:.2f} of {0.06 * (FRAMES - 1):.2f} world units.")


if __name__ == "__main__":
    tyro.cli(main)
