"""Choice of one factor for all quantization steps of a layer or a group, by the gain of finer steps in a held-out view.

Refinement stops where 10 % more bytes of the reel gain less than `MIN_GAIN`. The file is encoded with two factors, which gives the
bytes that larger steps save. The squared error of quantization is measured in training views. It grows with the square of the
factor; bytes fall with its logarithm.

The ratios between the steps of different attributes stay as in `STEPS`. Choosing the steps of each attribute by its own slope took
3 to 4 % more bytes at equal PSNR of held-out views (docs/experiments/2026-11-26-steps-by-slope.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch

from splatreel.codec import group_file
from splatreel.codec.encoder import ReelEncoder
from splatreel.codec.predictive.precision import STEPS, Steps
from splatreel.config import EncodeConfig
from splatreel.kernels import splat
from splatreel.recon.cameras.group_input import GroupInput
from splatreel.recon.coverage.trial import Trial
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.static_points import StaticPoints

MIN_GAIN = 0.03
"""Minimum gain of 10 % more bytes of the reel in a held-out view, dB."""
LAYER_GROUPS = 2
"""Assumed number of groups in which a layer is visible. It is encoded before the length of the video is known."""
MOVING_BYTES = 3.0
"""Bytes of a dynamic point in one group, as a multiple of those of a static point."""
LEAST_MOVING = 0.1
"""Minimum number of dynamic points per static point in a layer's share of the reel. The shared layer of all chapters is
encoded before any dynamic point is known."""
UNTRIED_ERROR_RATIO = 2.0
"""Squared error of held-out views as a multiple of that of training views, if no trial measured it."""
STEP_RATIO = 1.5
"""Ratio of the two factors that are compared."""
ROUNDS = 2
"""Number of measurements. The second starts at the factor that the first one chose."""
FINEST, COARSEST = 0.2, 4.0
"""Range of the factor."""
LAYER_VIEWS = 4
GROUP_MOMENTS, GROUP_VIEWS = 4, 1
"""Training views drawn per measurement: `LAYER_VIEWS` of a layer; of a group, `GROUP_VIEWS` at each of `GROUP_MOMENTS`
moments."""
PSNR_OF_ONE = 10 / math.log(10)
"""Decibels per relative change of the squared error."""

Shown = tuple[int, int, Gaussians]
"""A frame of the group, a training view, and the points to draw."""


class Subject(Protocol):
    """A layer or a group whose steps are chosen."""

    def encode(self, config: EncodeConfig, steps: Steps) -> bytes:
        """Return the file with these steps."""
        ...

    def as_trained(self) -> Iterable[Shown]:
        """Yield the moments with the points as trained."""
        ...

    def as_decoded(self, file: bytes) -> Iterable[Shown]:
        """Yield the same moments with the points of an encoded file."""
        ...


def encode_layer_by_slope(
    encoder: ReelEncoder,
    data: GroupInput,
    points: Gaussians,
    others: Gaussians,
    moving: int,
    importance: np.ndarray,
    trial: Trial | None,
) -> tuple[tuple[bytes, np.ndarray], Steps]:
    """Encode the points that are born at a group, with steps chosen by slope.

    Args:
        encoder: Encoder of the reel. The paper's codec has no steps to choose.
        data: Training views of the group.
        points: Static points of the new layer.
        others: All other points that are visible in the first frame.
        moving: Number of dynamic points among `others`.
        importance: [N, 3], see `ReelEncoder.layer`.
        trial: Measured quality of a held-out view; None if there was no trial.

    Returns:
        The result of `ReelEncoder.layer`, and the steps that it used.
    """
    moving = max(moving, round(LEAST_MOVING * len(points)))
    reel = len(points) + len(others) + (LAYER_GROUPS * MOVING_BYTES - 1) * moving
    share = len(points) / max(reel, 1.0)
    steps = _choose(encoder, data, _Layer(data, points, others, importance), trial, share)
    return encoder.layer(data.span.index, data.span.first, points, importance, steps), steps


def encode_group_by_slope(
    encoder: ReelEncoder,
    data: GroupInput,
    group: Group,
    static: StaticPoints,
    importance: np.ndarray | None,
    trial: Trial | None,
) -> tuple[dict[str, bytes], Steps]:
    """Encode a group with steps chosen by slope.

    Args:
        encoder: Encoder of the reel.
        data: Training views of the group.
        group: Dynamic points and their motion, as trained.
        static: All static points that `group.alive` refers to.
        importance: [N, 3], see `ReelEncoder.group`.
        trial: See `encode_layer_by_slope`.

    Returns:
        The result of `ReelEncoder.group`, and the steps that it used.
    """
    subject = _Group(data, group, static.points[group.alive], importance)
    moving = LAYER_GROUPS * MOVING_BYTES * len(group.dynamic)
    share = moving / max(moving + len(subject.resting), 1.0)
    steps = _choose(encoder, data, subject, trial, share)
    return encoder.group(group, importance, steps), steps


@dataclass(frozen=True)
class _Layer:
    data: GroupInput
    points: Gaussians
    others: Gaussians
    importance: np.ndarray

    def encode(self, config: EncodeConfig, steps: Steps) -> bytes:
        span = self.data.span
        return group_file.encode_layer(span.index, span.first, self.points, config, self.importance, steps)[0]

    def as_trained(self) -> Iterable[Shown]:
        return self._show(self.points)

    def as_decoded(self, file: bytes) -> Iterable[Shown]:
        return self._show(group_file.decode_layer(file, f"The layer of group {self.data.span.index}")[1])

    def _show(self, points: Gaussians) -> Iterable[Shown]:
        seen = Gaussians.concatenate([points, self.others])
        return ((0, view, seen) for view in _views(self.data, 0, LAYER_VIEWS))


@dataclass(frozen=True)
class _Group:
    data: GroupInput
    group: Group
    resting: Gaussians
    importance: np.ndarray | None

    def encode(self, config: EncodeConfig, steps: Steps) -> bytes:
        return group_file.encode_group(self.group, config, self.importance, steps)[0]

    def as_trained(self) -> Iterable[Shown]:
        return self._show(self.group)

    def as_decoded(self, file: bytes) -> Iterable[Shown]:
        return self._show(group_file.decode_group(file, f"Group {self.group.index}"))

    def _show(self, group: Group) -> Iterable[Shown]:
        frames = np.linspace(0, group.frames - 1, GROUP_MOMENTS).round().astype(int).tolist()
        for number, frame in enumerate(frames):
            seen = Gaussians.concatenate([group.at(float(frame)), self.resting])
            for view in _views(self.data, number, GROUP_VIEWS):
                yield frame, view, seen


def _views(data: GroupInput, number: int, count: int) -> list[int]:
    """Return `count` cameras spread over all cameras. Another number gives other cameras."""
    apart = max(len(data.cameras) // count, 1)
    return list(range(len(data.cameras)))[number % apart :: apart][:count]


def _choose(encoder: ReelEncoder, data: GroupInput, subject: Subject, trial: Trial | None, share: float) -> Steps:
    """Return the steps of a file. They are chosen for the default coarseness; another coarseness multiplies them.

    Args:
        encoder: Encoder of the reel.
        data: Training views.
        subject: Layer or group.
        trial: See `encode_layer_by_slope`.
        share: Share of the file in the bytes that the reel spends per group in which the file is visible.
    """
    if encoder.config.codec != "predictive":
        return STEPS
    config = replace(encoder.config, coarseness=EncodeConfig().coarseness)
    trained = [_draw(data, points, view) for _, view, points in subject.as_trained()]
    if not trained or not share:
        return STEPS
    held_out = _held_out_error(data, subject, trained, trial)
    factor = 1.0
    for _ in range(ROUNDS):
        fine, coarse = (subject.encode(config, STEPS.scaled(ratio * factor)) for ratio in (1.0, STEP_RATIO))
        moments = zip(subject.as_decoded(fine), trained, strict=True)
        error = np.mean([np.square(_draw(data, points, view) - image).mean() for (_, view, points), image in moments])
        saved = max(len(fine) - len(coarse), 1) / math.log(STEP_RATIO)
        price = MIN_GAIN * held_out / (PSNR_OF_ONE * 0.1 * len(fine) / share)
        factor = equal_slope(factor, saved, float(error), price)
    return STEPS.scaled(factor)


def equal_slope(factor: float, saved: float, error: float, price: float) -> float:
    """Return the factor at which one byte more reduces the mean squared error by `price`.

    Args:
        factor: Factor of the steps that the next two numbers were measured at.
        saved: Bytes that steps larger by a factor of e save.
        error: Mean squared error of quantization.
        price: Mean squared error per byte.
    """
    return min(max(factor * math.sqrt(price * saved / max(2 * error, 1e-30)), FINEST), COARSEST)


def _held_out_error(data: GroupInput, subject: Subject, trained: list[np.ndarray], trial: Trial | None) -> float:
    """Estimate the mean squared error of held-out views.

    The trial is small and quick, so it overestimates the error; the training views underestimate it. The estimate is their
    geometric mean, but at least the error of the training views.
    """
    errors = []
    for (frame, view, _), image in zip(subject.as_trained(), trained, strict=True):
        errors.append(np.square(image - data.images[frame, view] / np.float32(255)).mean())
    error = float(np.mean(errors))
    return UNTRIED_ERROR_RATIO * error if trial is None else max(error, math.sqrt(error * 10 ** (-trial.psnr / 10)))


@torch.no_grad()
def _draw(data: GroupInput, points: Gaussians, view: int) -> np.ndarray:
    """Draw a training view [H, W, 3] with its camera's color gain."""
    camera = data.cameras[view]
    arrays = points.means, points.quats, points.scales, points.opacities, points.sh
    means, quats, scales, opacities, sh = (torch.from_numpy(array).to(data.device) for array in arrays)
    size = camera.viewmat, camera.K, camera.width, camera.height
    found = splat.render(means, quats, scales, opacities, sh, *size, near=data.near, antialias=data.antialias)
    background = torch.tensor(data.layout.background, dtype=torch.float32, device=data.device)
    image = (found.image + (1 - found.alpha[..., None]) * background).cpu().numpy()
    return np.clip(image * data.gains[view], 0, 1)
