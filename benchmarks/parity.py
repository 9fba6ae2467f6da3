"""Compare a GPU with the CPU: the results of one training iteration, and images drawn per second."""

import math

import numpy as np
import torch
from torch import Tensor

from kernels import waiting
from splatreel.evaluation.bench.microbenchmarks import cloud, front_camera
from splatreel.evaluation.bench.step_timings import NEAR, UNIT
from splatreel.evaluation.bench.timing import median_ms
from splatreel.kernels import splat
from splatreel.method.train.render import StaticCache, View, deformed, draw
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.play.renderers import renderer
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians


def differences(points: int, width: int, height: int) -> dict[str, dict[str, float]]:
    """Compare an iteration of a keyframe and of a group: the largest difference of each part, as a share of the CPU's largest value.

    The parts are the loss and the gradients. In the group a quarter of the points moves, before the others, which do not.
    """
    gaussians, camera = cloud(points), front_camera(width, height)
    found = {}
    for stage in ("keyframe", "group"):
        expected, got = (iteration(gaussians, camera, torch.device(name), stage == "group") for name in ("cpu", "cuda"))
        found[stage] = {name: relative(got[name], value) for name, value in expected.items()}
    return found


def relative(got: Tensor, expected: Tensor) -> float:
    """Return the largest difference divided by the largest expected value.

    Raises:
        RuntimeError: A number is not finite.
    """
    error = float((got - expected).abs().max() / expected.abs().max().clamp_min(1e-12))
    if not math.isfinite(error):
        raise RuntimeError("the GPU found numbers that are not finite, in an iteration where the CPU did not")
    return float(f"{error:.3g}")


def iteration(gaussians: Gaussians, camera: Camera, device: torch.device, among: bool) -> dict[str, Tensor]:
    """Return the loss and the gradients of an iteration, as tensors on the CPU.

    Args:
        among: A quarter of the points moves among the others.
    """
    view = View.of(camera, device, antialias=True)
    count = len(gaussians) // 4 if among else len(gaussians)
    points = TrainablePoints.from_gaussians(gaussians[np.arange(count)], default_rates(UNIT), device)
    rng = np.random.default_rng(0)
    target = torch.from_numpy(rng.integers(0, 255, (view.height, view.width, 3), np.uint8)).to(device)
    changes, static = {}, None
    if among:
        dq = rng.normal([1, 0, 0, 0], 0.05, (count, 4))
        arrays = {"dx": rng.normal(0, 0.02, (count, 3)), "dq": dq, "shade": rng.normal(0, 0.1, (count, 4))}
        changes = {name: torch.from_numpy(array.astype(np.float32)).to(device) for name, array in arrays.items()}
        changes = {name: tensor.requires_grad_() for name, tensor in changes.items()}
        static = StaticCache(gaussians[np.arange(count, len(gaussians))], [view], NEAR, device).view(0)
    offsets = (changes["dx"], changes["dq"]) if among else None
    drawing = draw(deformed(points.params, offsets, changes.get("shade"), view, NEAR), view, static)
    loss = splat.photometric_loss(drawing.image, target, tiles=drawing.tiles)
    loss.backward()
    leaves = points.params | changes
    gradients = {name: leaf.grad.cpu() for name, leaf in leaves.items() if leaf.grad is not None}
    return {"loss": loss.detach().cpu(), **gradients}


def drawing(points: int, width: int, height: int, repeats: int) -> dict[str, float]:
    """Return images drawn per second.

    On `cuda`, they stay on the GPU. `view` copies from and to NumPy, as `splatreel view` does.
    """
    gaussians, camera = cloud(points), front_camera(width, height)
    arrays = (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)
    means, quats, scales, opacities, sh = (torch.from_numpy(array).cuda() for array in arrays)
    viewmat, K = (torch.from_numpy(array).cuda() for array in (camera.viewmat, camera.K))

    @torch.no_grad()
    def on_gpu() -> None:
        splat.render(means, quats, scales, opacities, sh, viewmat, K, width, height, near=NEAR)

    plain = (gaussians, camera, NEAR, False, (0.0, 0.0, 0.0))
    works = {"cuda": waiting(on_gpu), "view cuda": lambda: renderer("cuda")(*plain)}
    works["view cpu"] = lambda: renderer("cpu")(*plain)
    return {name: round(1000 / median_ms(work, repeats), 1) for name, work in works.items()}
