"""Scenes for the tests of kernels, and the comparison of a kernel's results and gradients with known ones."""

# pyright: reportCallIssue=false
# Pyright assumes that an unpacked list fills all remaining positional arguments.

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splatreel.kernels.splat import Splats

Arrays = tuple[np.ndarray, ...]
Gradient = Callable[[Arrays], tuple[np.ndarray | None, ...]]
"""From the gradients to the float outputs of a kernel to the gradients to its inputs; None where it computes none."""
Kernel = Callable[..., tuple[Arrays, Gradient]]
"""From inputs to outputs, and their gradient."""


def floats(values: Any) -> np.ndarray:
    return np.array(values, np.float32)


def assert_close(found: np.ndarray, expected: np.ndarray, tolerance: float, what: str) -> None:
    """Compare relative to the largest expected value."""
    assert found.shape == expected.shape, what
    if found.size:
        error = float(np.abs(found.astype(np.float64) - expected).max())
        assert error <= tolerance * max(float(np.abs(expected).max()), 1e-6), f"{what}: off by {error}"


def slopes(outputs: Arrays) -> Arrays:
    """Return a gradient to each output of floats, the same one in every process."""
    state = np.random.RandomState(1)
    return tuple(np.asarray(state.randn(*output.shape), np.float32) for output in outputs if output.dtype.kind == "f")


def assert_equals_differences(kernel: Kernel, inputs: Sequence[np.ndarray], step: float, tolerance: float) -> None:
    """Compare the gradient to every input with central differences, along the gradient and along a random direction."""
    outputs, gradient = kernel(*inputs)
    weights, state = slopes(outputs), np.random.RandomState(2)

    def value(k: int, direction: np.ndarray) -> float:
        moved = [*inputs]
        moved[k] = (inputs[k] + direction).astype(np.float32)
        floats = [output for output in kernel(*moved)[0] if output.dtype.kind == "f"]
        return sum(float(np.sum(w * o, dtype=np.float64)) for w, o in zip(weights, floats, strict=True))

    for k, (before, slope) in enumerate(zip(inputs, gradient(weights), strict=True)):
        if slope is None or not slope.size:
            continue
        steepest = slope / max(np.sqrt(np.mean(slope**2)), 1e-20)
        for direction in (steepest, state.randn(*slope.shape)):
            size = step * max(float(np.sqrt(np.mean(before**2))), 1e-3)
            moved = (size * direction).astype(np.float32)
            found = float(np.sum(slope * moved, dtype=np.float64))
            expected = (value(k, moved) - value(k, -moved)) / 2
            room = tolerance * float(np.linalg.norm(slope) * np.linalg.norm(moved)) / np.sqrt(slope.size) ** 0.5
            assert abs(found - expected) <= room, f"input {k}: {found}, by differences {expected}, room {room}"


def splats(n: int, channels: int, width: int, height: int, seed: int = 0) -> Splats:
    """Return splats. Some are off the image, at equal depth, or culled."""
    state = np.random.RandomState(seed)
    means2d = state.uniform(-6, 6, (n, 2)) + state.uniform(0, 1, (n, 2)) * [width, height]
    half = state.normal(0, 2.5, (n, 2, 2))
    conics = np.linalg.inv(half @ half.transpose(0, 2, 1) + 0.3 * np.eye(2))[:, [0, 0, 1], [0, 1, 1]]
    depths = np.round(state.uniform(1, 5, n), 1)
    radii = (state.uniform(size=n) > 0.1).astype(np.int32)
    arrays = means2d, conics, state.uniform(0, 1, (n, channels)), state.uniform(0, 1, n), depths
    return Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays), radii)


def gaussians(n: int, bands: int = 16, seed: int = 0) -> list[np.ndarray]:
    """Return means, quats (not normalized), scales, opacities and sh of Gaussians around the origin."""
    state = np.random.RandomState(seed)
    scales, opacities = state.rand(n, 3) * 0.3 + 0.02, state.rand(n)
    means, quats, sh = (state.randn(*shape) for shape in ((n, 3), (n, 4), (n, bands, 3)))
    return [array.astype(np.float32) for array in (means * 1.2, quats, scales, opacities, sh * 0.3)]


def camera(width: int, height: int, distance: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Return viewmat and K of a camera in general position, with its principal point off the center."""
    rotation = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    viewmat[:3, 3] = (0.1, 0.2, distance)
    K = np.array([[1.1 * width, 0, width / 2 + 2], [0, 1.2 * width, height / 2 - 1], [0, 0, 1]])
    return viewmat.astype(np.float32), K.astype(np.float32)
