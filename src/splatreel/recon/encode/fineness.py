"""How fine the steps of a file must be, for encoding to spoil little of how well its points fit the pictures they were trained on.

Steps are chosen for pictures that are met to about 32 dB, where errors of a reconstruction hide those of its encoding. Where noise is
low and surfaces are plain it comes much nearer to its pictures, and the same steps show. What counts are new views, which are met less
closely than those that are trained on: as closely at most as that of a camera that was left out in a trial (`coverage.trial`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import torch

from splatreel.codec.encoder import ReelEncoder
from splatreel.codec.group_file import decode_group, decode_layer
from splatreel.kernels import splat
from splatreel.recon.cameras.group_input import GroupInput
from splatreel.recon.coverage.trial import Trial
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.static_points import StaticPoints

LAYER_LOSS, GROUP_LOSS = 0.025, 0.05
"""Decibels that encoding may cost: of a layer, which all groups show, and of a group. It costs new views about half of that."""
FINEST = 0.2
"""Of the usual steps: nothing is better where points meet a picture that has no noise at all."""
LAYER_VIEWS = 6
GROUP_MOMENTS, GROUP_VIEWS = 4, 2
"""Pictures that are looked at, of a layer; moments of a group, and pictures of each."""

Shown = tuple[int, int, Gaussians, Gaussians]
"""A frame of the group, a camera, and what is to be seen there before and after encoding."""


def encode_layer(
    encoder: ReelEncoder,
    data: GroupInput,
    points: Gaussians,
    others: Gaussians,
    importance: np.ndarray,
    trial: Trial | None,
) -> tuple[tuple[bytes, np.ndarray], float]:
    """What `ReelEncoder.layer` makes of points that are born at a group, and the fineness that it took.

    others: what else is to be seen in the first frame. trial: how closely new views are met; None: not known, the steps are the usual
    ones.
    """
    span = data.span

    def encode(fineness: float) -> tuple[bytes, np.ndarray]:
        return encoder.layer(span.index, span.first, points, importance, fineness)

    encoded = encode(1.0)
    if trial is None or encoder.config.codec != "predictive":
        return encoded, 1.0
    decoded = decode_layer(encoded[0], f"The layer of group {span.index}")[1]
    before, after = (Gaussians.concatenate([some, others]) for some in (points, decoded))
    shown = ((0, view, before, after) for view in _views(data, 0, LAYER_VIEWS))
    fineness = _needed(data, shown, trial, LAYER_LOSS)
    return (encoded if fineness == 1 else encode(fineness)), fineness


def encode_group(
    encoder: ReelEncoder,
    data: GroupInput,
    group: Group,
    static: StaticPoints,
    importance: np.ndarray | None,
    trial: Trial | None,
) -> tuple[dict[str, bytes], float]:
    """What `ReelEncoder.group` makes of a group, and the fineness that it took. static: all that `group.alive` speaks of.

    trial: as of a layer.
    """
    files = encoder.group(group, importance)
    if trial is None or encoder.config.codec != "predictive":
        return files, 1.0
    uri, best = next(iter(files.items()))
    decoded, resting = decode_group(best, uri), static.points[group.alive]

    def shown() -> Iterable[Shown]:
        for number, frame in enumerate(np.linspace(0, group.frames - 1, GROUP_MOMENTS).round().astype(int)):
            before, after = (Gaussians.concatenate([some.at(float(frame)), resting]) for some in (group, decoded))
            for view in _views(data, number, GROUP_VIEWS):
                yield int(frame), view, before, after

    fineness = _needed(data, shown(), trial, GROUP_LOSS)
    return (files if fineness == 1 else encoder.group(group, importance, fineness)), fineness


def _views(data: GroupInput, number: int, count: int) -> list[int]:
    """Some cameras, spread over all; others for another number."""
    apart = max(len(data.cameras) // count, 1)
    return list(range(len(data.cameras)))[number % apart :: apart][:count]


def _needed(data: GroupInput, shown: Iterable[Shown], trial: Trial, loss: float) -> float:
    """What steps are to be multiplied by, at most 1: errors of steps add to those of the points, as their squares do.

    loss: decibels that are allowed.
    """
    wrong, lost = np.mean([_errors(data, *one) for one in shown], axis=0).tolist()
    wrong = max(wrong, 10 ** (-trial.psnr / 10))
    allowed = wrong * (10 ** (loss / 10) - 1)
    return 1.0 if lost <= allowed else max(math.sqrt(allowed / lost), FINEST)


def _errors(data: GroupInput, frame: int, view: int, before: Gaussians, after: Gaussians) -> tuple[float, float]:
    """Mean squares of how far points are from a picture, and encoded ones from them."""
    camera, gain = data.cameras[view], data.gains[view]
    trained, encoded = (np.clip(_draw(data, points, camera) * gain, 0, 1) for points in (before, after))
    truth = data.images[frame, view] / np.float32(255)
    return float(np.square(trained - truth).mean()), float(np.square(encoded - trained).mean())


@torch.no_grad()
def _draw(data: GroupInput, points: Gaussians, camera: Camera) -> np.ndarray:
    """[H, W, 3]"""
    arrays = points.means, points.quats, points.scales, points.opacities, points.sh
    means, quats, scales, opacities, sh = (torch.from_numpy(array).to(data.device) for array in arrays)
    view = camera.viewmat, camera.K, camera.width, camera.height
    found = splat.render(means, quats, scales, opacities, sh, *view, near=data.near, antialias=data.antialias)
    background = torch.tensor(data.layout.background, dtype=torch.float32, device=data.device)
    return (found.image + (1 - found.alpha[..., None]) * background).cpu().numpy()
