"""Measure the CPU kernels: median milliseconds of each part of a training step, and of the torch twin.

python benchmarks/kernels.py [--record] [--repeats 21] [--note TEXT]

Splats are spread evenly over the view, with a log-normal radius of 4 pixels on average, as a trained capture has them.
"""

from collections.abc import Callable
from typing import Annotated

import numpy as np
import torch
import tyro
from torch import Tensor

from record import record
from splatreel.base import threads
from splatreel.evaluation.bench.timing import median_ms
from splatreel.kernels import splat, twin
from splatreel.kernels.splat import Projection

SCENES = ((20_000, 320, 240), (20_000, 640, 480), (100_000, 640, 480))
SMALL = (500, 64, 48)  # all the twin can hold: it meets every pixel with every splat


def main(repeats: int = 21, note: str = "", save: Annotated[bool, tyro.conf.arg(name="record")] = False) -> None:
    """Print the table; with --record, also append it to results.jsonl."""
    scenes = {f"{n} {w}x{h}": measure(splat, n, w, h, repeats) for n, w, h in (*SCENES, SMALL)}
    scenes[f"{SMALL[0]} {SMALL[1]}x{SMALL[2]}, twin"] = measure(twin, *SMALL, repeats)
    parts = list(next(iter(scenes.values())))
    print(f"{'median ms':<22}" + "".join(f"{part:>14}" for part in parts))
    for name, row in scenes.items():
        print(f"{name:<22}" + "".join(f"{row[part]:>14.2f}" for part in parts))
    if save:
        record("kernels", {"milliseconds": scenes, "threads": threads.count()}, note)


def measure(kernels, n: int, width: int, height: int, repeats: int, device: str = "cpu") -> dict[str, float]:
    """Return the timings of the parts of a step.

    Args:
        functions: The module `splat` or `twin`.
        device: cpu or cuda.
    """
    means, quats, scales, opacities, sh, K = (tensor.to(device) for tensor in scene(n, width, height))
    leaves = [tensor.requires_grad_() for tensor in (means, quats, scales, opacities, sh)]
    target = torch.rand(height, width, 3, generator=torch.Generator().manual_seed(0)).to(device)
    viewmat = torch.eye(4, device=device)

    def project() -> Projection:
        return kernels.project(means, quats, scales, viewmat, K, width, height)

    def color() -> Tensor:
        return (kernels.spherical_harmonics(3, means, sh) + 0.5).clamp_min(0)

    projected, colored = Projection(*[t.detach() for t in project()]), color().detach()

    def rasterize() -> Tensor:
        return kernels.rasterize(projected.colored(colored, opacities), width, height)[0]

    image = rasterize().detach().requires_grad_()
    for tensor in (projected.means2d, projected.conics, colored):
        tensor.requires_grad_()

    def step() -> None:
        image, _ = kernels.rasterize(project().colored(color(), opacities), width, height)
        kernels.photometric_loss(image, target).backward()
        for leaf in leaves:
            leaf.grad = None

    parts = {
        "project": project,
        "+ backward": lambda: (project()[0].sum() + project()[1].sum()).backward(),
        "SH + backward": lambda: color().sum().backward(),
        "rasterize": rasterize,
        "& backward": lambda: rasterize().sum().backward(),
        "loss + grad": lambda: kernels.photometric_loss(image, target).backward(),
        "whole step": step,
    }
    return {name: median_ms(waiting(part) if device == "cuda" else part, repeats) for name, part in parts.items()}


def waiting(work: Callable[[], object]) -> Callable[[], None]:
    """Return the work with a wait for the GPU at its end."""

    def done() -> None:
        work()
        torch.cuda.synchronize()

    return done


def scene(n: int, width: int, height: int) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Return means, quats, scales, opacities, sh, and K of a camera at the origin that looks along z."""
    rng = np.random.default_rng(0)
    depth = rng.uniform(2, 10, n)
    offset = rng.uniform(-0.5, 0.5, (n, 2)) * [width, height] / width
    means = np.concatenate([offset * depth[:, None], depth[:, None]], 1)
    radius = np.clip(rng.lognormal(np.log(4) - 0.32, 0.8, n), 0.8, 24) / 3.33
    flatness = np.concatenate([np.ones((n, 1)), rng.uniform(0.2, 1, (n, 2))], 1)
    scales = flatness * (radius * depth / width)[:, None]
    opacities = 1 / (1 + np.exp(-rng.normal(0.3, 1.5, n)))
    arrays = (means, rng.normal(size=(n, 4)), scales, opacities, 0.3 * rng.normal(size=(n, 16, 3)))
    tensors = [torch.from_numpy(array.astype(np.float32)) for array in arrays]
    K = torch.tensor([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]])
    return tensors[0], tensors[1], tensors[2], tensors[3], tensors[4], K


if __name__ == "__main__":
    tyro.cli(main)
