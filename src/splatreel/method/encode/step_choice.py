"""Choice of the quantization steps of a layer or a group, by the gain of finer steps in a held-out view.

All attributes of a file get the same slope: one byte more buys the same reduction of the squared error, whichever attribute it
is spent on. Refinement stops where 10 % more bytes gain less than `MIN_GAIN`. docs/experiments/2026-11-26-steps-by-slope.md has the
measurements.

Two numbers are measured per attribute, at two sets of steps that differ by a factor. The first is the bytes that the factor
saves. The second is the squared error of this attribute's quantization in training views, with all other attributes as trained.
The error grows with the square of the step; bytes fall with the logarithm of the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from typing import Protocol

import numpy as np

from splatreel.base import threads
from splatreel.codec import group_file
from splatreel.codec.container import unpack_file
from splatreel.codec.encoder import EncodedLayer, ReelEncoder
from splatreel.codec.predictive.precision import STEPS, Steps
from splatreel.config import EncodeConfig
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.prediction.trial import Trial
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group

MIN_GAIN = 0.03
"""Minimum gain of 10 % more bytes of the reel in a held-out view, dB."""
LAYER_GROUPS = 2
"""Assumed number of groups in which a layer is visible. It is encoded before the length of the video is known."""
MOVING_BYTES = 3.0
"""Bytes of a dynamic point in one group, as a multiple of those of a static point."""
LEAST_MOVING = 0.1
"""Minimum number of dynamic points per static point in a layer's share of the reel. The shared layer of all chapters is
encoded before any dynamic point is known."""
HELD_OUT_SHARE = {"rest": 0.25, "shade": 0.25}
"""Share of an attribute's training-view error that held-out views have; 1 for all others. View-dependent color and shade
overfit the training views, noise included, and coarser steps remove some of that noise."""
UNTRIED_ERROR_RATIO = 2.0
"""Squared error of held-out views as a multiple of that of training views, if no trial measured it."""
STEP_RATIO = 1.5
"""Factor between the two sets of steps that are compared."""
LEAST_SAVED = 0.03
"""Minimum share of an attribute's bytes that the factor is assumed to save. The bytes of small sections hardly depend on the
steps."""
ROUNDS = 2
"""Number of measurements. The second uses the steps that the first one chose."""
FINEST, COARSEST = 0.2, 4.0
"""Range of the chosen steps, in multiples of `STEPS`."""
LAYER_VIEWS = 4
GROUP_MOMENTS, GROUP_VIEWS = 4, 1
"""Training views drawn per measurement: `LAYER_VIEWS` of a layer; of a group, `GROUP_VIEWS` at each of `GROUP_MOMENTS`
moments."""
PSNR_OF_ONE = 10 / math.log(10)
"""Decibels per relative change of the squared error."""

Encoded = tuple[bytes, np.ndarray]
"""A file, and the order [N] of its points: the index of each among the points that were encoded."""
Shown = tuple[int, int, Gaussians]
"""A frame of the group, a training view, and the points to draw."""
SECTIONS = {
    "position": ("means", "places"),
    "shape": ("shapes",),
    "opacity": ("opacities",),
    "color": ("sh_base",),
    "rest": ("sh_rest",),
    "motion": ("dx",),
    "turn": ("dq",),
    "shade": ("shade",),
}
"""Sections of a file by the field of `Steps` that quantizes them."""


@dataclass(frozen=True)
class Slope:
    """Measurement of one attribute at some steps.

    saved: bytes that steps larger by a factor of e save. error: mean squared error in held-out views.
    """

    saved: float
    error: float


class Subject(Protocol):
    """A layer or a group whose steps are chosen."""

    def encode(self, config: EncodeConfig, steps: Steps) -> Encoded:
        """Encode with these steps."""
        ...

    def as_trained(self) -> Iterable[Shown]:
        """Yield the moments with all attributes as trained."""
        ...

    def decoder(self, encoded: Encoded) -> Callable[[str], Iterable[Shown]]:
        """Return a function that yields the same moments with one attribute as decoded and all others as trained."""
        ...


def encode_layer_by_slope(
    encoder: ReelEncoder,
    data: GroupInput,
    points: Gaussians,
    others: Gaussians,
    moving: int,
    importance: np.ndarray,
    trial: Trial | None,
) -> tuple[EncodedLayer, Steps]:
    """Encode the points that are born at a group, with steps chosen by slope. Return the result of `ReelEncoder.layer`, and the steps.

    `others` are all other points that are visible in the first frame, `moving` of them dynamic. The paper's codec has
    no steps to choose.
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
    """Encode a group with steps chosen by slope. Return the result of `ReelEncoder.group`, and the steps."""
    subject = _Group(data, group, static.points[group.alive], importance)
    moving = LAYER_GROUPS * MOVING_BYTES * len(group.dynamic)
    share = moving / max(moving + len(subject.static), 1.0)
    steps = _choose(encoder, data, subject, trial, share)
    return encoder.group(group, importance, steps), steps


@dataclass(frozen=True)
class _Layer:
    data: GroupInput
    points: Gaussians
    others: Gaussians
    importance: np.ndarray

    def encode(self, config: EncodeConfig, steps: Steps) -> Encoded:
        span = self.data.span
        return group_file.encode_layer(span.index, span.first, self.points, config, self.importance, steps)

    def as_trained(self) -> Iterable[Shown]:
        return self._show(self.points)

    def decoder(self, encoded: Encoded) -> Callable[[str], Iterable[Shown]]:
        file, order = encoded
        decoded = group_file.decode_layer(file, f"The layer of group {self.data.span.index}")[1]
        trained = self.points[order]
        return lambda attribute: self._show(with_decoded(attribute, trained, decoded))

    def _show(self, points: Gaussians) -> Iterable[Shown]:
        seen = Gaussians.concatenate([points, self.others])
        return ((0, view, seen) for view in _views(self.data, 0, 0, LAYER_VIEWS))


@dataclass(frozen=True)
class _Group:
    data: GroupInput
    group: Group
    static: Gaussians
    importance: np.ndarray | None

    def encode(self, config: EncodeConfig, steps: Steps) -> Encoded:
        return group_file.encode_group(self.group, config, self.importance, steps)

    def as_trained(self) -> Iterable[Shown]:
        return self._show(self.group.at)

    def decoder(self, encoded: Encoded) -> Callable[[str], Iterable[Shown]]:
        file, order = encoded
        trained, decoded = in_order(self.group, order), group_file.decode_group(file, f"Group {self.group.index}")
        return lambda attribute: self._show(lambda frame: with_decoded_at(attribute, trained, decoded, frame))

    def _show(self, at: Callable[[float], Gaussians]) -> Iterable[Shown]:
        frames = np.linspace(0, self.group.frames - 1, GROUP_MOMENTS).round().astype(int).tolist()
        for number, frame in enumerate(frames):
            seen = Gaussians.concatenate([at(float(frame)), self.static])
            for view in _views(self.data, frame, number, GROUP_VIEWS):
                yield frame, view, seen


def _views(data: GroupInput, frame: int, number: int, count: int) -> list[int]:
    """Return `count` cameras spread over all cameras that have a frame. Another number gives other cameras."""
    missing = np.zeros(len(data.cameras), bool) if data.missing is None else data.missing[frame]
    cameras = np.flatnonzero(~missing).tolist()
    apart = max(len(cameras) // count, 1)
    return cameras[number % apart :: apart][:count]


def _choose(encoder: ReelEncoder, data: GroupInput, subject: Subject, trial: Trial | None, share: float) -> Steps:
    """Return the steps of a file. They are chosen for the default coarseness; another coarseness multiplies them.

    `share` is the share of the file in the bytes that the reel spends per group in which the file is visible.
    """
    if encoder.config.codec != "predictive":
        return STEPS
    config = replace(encoder.config, coarseness=EncodeConfig().coarseness)
    trained = threads.map_parallel(lambda shown: _draw(data, shown[2], shown[1]), subject.as_trained())
    if not trained or not share:
        return STEPS
    held_out = _held_out_error(data, subject, trained, trial)
    steps = STEPS
    for _ in range(ROUNDS):
        sizes = [steps.scaled(factor) for factor in (1.0, STEP_RATIO)]
        fine, coarse = threads.map_parallel(lambda size: subject.encode(config, size), sizes)
        slopes, show = {}, subject.decoder(fine)
        before, after = attribute_bytes(fine[0]), attribute_bytes(coarse[0])
        errors = threads.map_parallel(lambda name, show=show: _drawing_error(data, show(name), trained), before)
        for (attribute, size), error in zip(before.items(), errors, strict=True):
            saved = max(size - after.get(attribute, 0), LEAST_SAVED * size, 1) / math.log(STEP_RATIO)
            slopes[attribute] = Slope(saved, error * HELD_OUT_SHARE.get(attribute, 1.0))
        steps = equal_slopes(steps, slopes, MIN_GAIN * held_out / (PSNR_OF_ONE * 0.1 * len(fine[0]) / share))
    return steps


def equal_slopes(steps: Steps, slopes: dict[str, Slope], price: float) -> Steps:
    """Return steps at which one byte more reduces the mean squared error by `price`, for every attribute.

    `slopes` were measured at `steps`. Attributes without a slope keep their steps.
    """
    chosen = asdict(steps)
    for attribute, slope in slopes.items():
        factor = math.sqrt(price * slope.saved / max(2 * slope.error, 1e-30))
        usual = getattr(STEPS, attribute)
        chosen[attribute] = min(max(chosen[attribute] * factor, FINEST * usual), COARSEST * usual)
    return Steps(**chosen)


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


def _drawing_error(data: GroupInput, moments: Iterable[Shown], trained: list[np.ndarray]) -> float:
    """Return the mean squared difference between drawings of moments and the drawings `trained` of the same moments."""
    pairs = zip(moments, trained, strict=True)
    return float(np.mean([np.square(_draw(data, points, view) - image).mean() for (_, view, points), image in pairs]))


def _draw(data: GroupInput, points: Gaussians, view: int) -> np.ndarray:
    """Draw a training view [H, W, 3] with its camera's color gain."""
    return np.clip(data.draw(points, data.cameras[view]) * data.gains[view], 0, 1)


def attribute_bytes(data: bytes) -> dict[str, int]:
    """Return the bytes of each attribute that a layer's or a group's file holds."""
    found = {name: len(section.data) for name, section in unpack_file(data)[1].items()}
    return {
        attribute: sum(found[name] for name in names)
        for attribute, names in SECTIONS.items()
        if all(name in found for name in names)
    }


def in_order(group: Group, order: np.ndarray) -> Group:
    """Return a group with its dynamic points in another order [N]."""
    shade = None if group.shade is None else group.shade[:, order]
    return replace(group, dynamic=group.dynamic[order], dx=group.dx[:, order], dq=group.dq[:, order], shade=shade)


def with_decoded(attribute: str, trained: Gaussians, decoded: Gaussians) -> Gaussians:
    """Return static points with one attribute of `decoded`. The points of both have the same order."""
    return _REPLACE[attribute](trained, decoded)


def with_decoded_at(attribute: str, trained: Group, decoded: Group, frame: float) -> Gaussians:
    """Return the dynamic points of `trained` at a frame, with one attribute of `decoded`. Both have the same order."""
    before, after = trained.dynamic, decoded.dynamic
    moment, other = trained.at(frame), decoded.at(frame)
    if attribute == "motion":
        return replace(moment, means=before.means + (other.means - after.means))
    if attribute == "turn":
        return replace(moment, quats=rotations.multiply(_turns(other, after), before.quats))
    if attribute == "shade":
        base = before.sh[:, 0] + other.sh[:, 0] - after.sh[:, 0]
        opacities = before.opacities + other.opacities - after.opacities
        return _recolored(moment, base, np.clip(opacities, 0, 1))
    if attribute == "position":
        return replace(moment, means=moment.means + (after.means - before.means))
    if attribute == "shape":
        return replace(moment, quats=rotations.multiply(_turns(moment, before), after.quats), scales=after.scales)
    if attribute == "opacity":
        return replace(moment, opacities=np.clip(moment.opacities + after.opacities - before.opacities, 0, 1))
    if attribute == "color":
        return _recolored(moment, moment.sh[:, 0] + after.sh[:, 0] - before.sh[:, 0], moment.opacities)
    return _REPLACE[attribute](moment, after)


def _turns(moment: Gaussians, canonical: Gaussians) -> np.ndarray:
    """Return the rotations [N, 4] about the world's axes that took canonical points to a moment."""
    return rotations.multiply(moment.quats, rotations.conjugate(canonical.quats))


def _recolored(points: Gaussians, base: np.ndarray, opacities: np.ndarray) -> Gaussians:
    sh = np.concatenate([base[:, None], points.sh[:, 1:]], 1).astype(np.float32)
    return replace(points, sh=sh, opacities=opacities.astype(np.float32))


_REPLACE: dict[str, Callable[[Gaussians, Gaussians], Gaussians]] = {
    "position": lambda before, after: replace(before, means=after.means),
    "shape": lambda before, after: replace(before, quats=after.quats, scales=after.scales),
    "opacity": lambda before, after: replace(before, opacities=after.opacities),
    "color": lambda before, after: _recolored(before, after.sh[:, 0], before.opacities),
    "rest": lambda before, after: replace(before, sh=np.concatenate([before.sh[:, :1], after.sh[:, 1:]], 1)),
}
