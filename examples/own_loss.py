"""Train one frame with a loss of your own, in plain numpy.

python examples/own_loss.py --weight 0.5

The scene is made up: a wall of round Gaussians that eight cameras film. The loss makes Gaussians flat, as methods for surfaces do: the
shortest axis of each costs something. A loss is a function from `seen` to its value and its gradients, by name. It may look at the
points (`seen.points`), the drawing (`seen.image`) and the training image (`seen.target`), and may return gradients to the drawing
("image") and to any of the points. `examples/own_loss_torch.py` leaves the gradients to PyTorch.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import tyro

import splatreel
from splatreel.training import reconstruct_frame

WIDTH, HEIGHT = 96, 64


def flatness(weight: float) -> Callable[[Any], tuple[float, Mapping[str, np.ndarray]]]:
    """Return a loss: the mean share of the shortest axis in the three axes of each Gaussian."""

    def loss(seen: Any) -> tuple[float, Mapping[str, np.ndarray]]:
        scales = np.exp(seen.points["log_scales"])  # [N, 3]
        total = scales.sum(1, keepdims=True)
        shares = scales / total
        shortest = np.eye(3, dtype=np.float32)[shares.argmin(1)]
        share = (shares * shortest).sum(1, keepdims=True)
        # d share / d log scale = share (1 if it is the shortest axis, else 0) - share times the share of the axis
        slope = weight / len(scales) * share * (shortest - shares)
        return weight * float(share.mean()), {"log_scales": slope}

    return loss


def make_scene() -> splatreel.Gaussians:
    """Make round Gaussians of random colors in a slab."""
    rng = np.random.default_rng(0)
    return splatreel.Gaussians(
        means=rng.uniform([-2, -1.4, -0.3], [2, 1.4, 0.3], (500, 3)),
        quats=np.tile([1.0, 0, 0, 0], (500, 1)),
        scales=np.full((500, 3), 0.1),
        opacities=np.full(500, 0.9),
        sh=rng.uniform(-1.7, 1.7, (500, 1, 3)),
    )


def make_cameras() -> list[splatreel.Camera]:
    """Place eight cameras side by side, looking along +z."""
    K = np.array([[WIDTH, 0, WIDTH / 2], [0, WIDTH, HEIGHT / 2], [0, 0, 1]])
    cameras = []
    for index, x in enumerate(np.linspace(-1.2, 1.2, 8)):
        viewmat = np.eye(4)
        viewmat[:3, 3] = [-x, 0.3 * (index % 2), 4]
        cameras.append(splatreel.Camera(f"cam{index}", viewmat, K, WIDTH, HEIGHT))
    return cameras


def main(weight: float = 0.5, iterations: int = 200) -> None:
    """Train the frame without and with the loss.

    Args:
        weight: Weight of the loss.
        iterations: Iterations of each training.
    """
    scene, cameras = make_scene(), make_cameras()
    images = np.array([splatreel.render(scene, camera, near=0.1) for camera in cameras])
    config = splatreel.preset("draft")
    config = replace(config, keyframe=replace(config.keyframe, first_iterations=iterations))
    for name, losses in (("without", []), ("with", [flatness(weight)])):
        found = reconstruct_frame(images, cameras, config, points=scene.means, losses=losses, device="cpu")
        shortest = found.scales.min(1) / found.scales.sum(1)
        error = np.mean(
            [np.square(splatreel.render(found, c) - i).mean() for c, i in zip(cameras, images, strict=True)]
        )
        print(f"{name} the loss: shortest axis {shortest.mean():.3f} of all, PSNR {-10 * np.log10(error):.1f} dB")


if __name__ == "__main__":
    tyro.cli(main)
