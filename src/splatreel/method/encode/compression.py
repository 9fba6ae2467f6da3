"""Compression of new static points and of finished groups (paper section 4.3). Nothing is written here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.codec.encoder import EncodedLayer, ReelEncoder
from splatreel.codec.group_file import decode_parts
from splatreel.codec.header import ReelHeader
from splatreel.codec.predictive.precision import Steps
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.encode.importance import group_importance, weigh
from splatreel.method.encode.step_choice import encode_group_by_slope, encode_layer_by_slope
from splatreel.method.prediction.trial import Trial
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group, GroupSpan


@dataclass(frozen=True)
class Coding:
    """Encoder of a reel, and the properties of the run that decide how many bits points get.

    Attributes:
        encoder: Encoder of layers and groups.
        header: Header of the reel, whose cameras measure the importance of points.
        trial: Result of the trial that left a camera out; None if there was no trial.
    """

    encoder: ReelEncoder
    header: ReelHeader
    trial: Trial | None


@dataclass(frozen=True)
class CompressedLayer:
    """The static points that a group adds, in the order of the reel.

    Attributes:
        group: Number of the group.
        first_frame: First frame of the group.
        trained: Points [N] as trained.
        decoded: The same points as the reel holds them.
        importance: [N, 3], see `ReelEncoder.layer`.
        steps: Quantization steps at a coarseness of 1.
        files: Files of the layer's parts.
    """

    group: int
    first_frame: int
    trained: Gaussians
    decoded: Gaussians
    importance: np.ndarray
    steps: Steps
    files: tuple[bytes, ...]

    @staticmethod
    def of(
        span: GroupSpan, points: Gaussians, importance: np.ndarray, steps: Steps, encoded: EncodedLayer
    ) -> CompressedLayer:
        """Return the layer of points [N] in the order of training. `encoded`: the result of `ReelEncoder.layer` for them."""
        files, order = encoded
        decoded = decode_parts(files, f"The layer of group {span.index}")
        return CompressedLayer(span.index, span.first, points[order], decoded, importance[order], steps, files)

    @property
    def encoded(self) -> EncodedLayer:
        """The files, and the order of the points among `trained`."""
        return self.files, np.arange(len(self.trained))


@dataclass(frozen=True)
class CompressedGroup:
    """A finished group.

    Attributes:
        group: The group as trained.
        importance: [N, 3] of its dynamic points; None where the codec does not use it.
        steps: Quantization steps at a coarseness of 1.
        files: Files by URI, the best rendition first.
    """

    group: Group
    importance: np.ndarray | None
    steps: Steps
    files: dict[str, bytes]


def compress_layer(
    data: GroupInput, points: Gaussians, moving: Gaussians, static: Gaussians, coding: Coding
) -> CompressedLayer:
    """Encode new static points as a layer, and decode them again.

    Args:
        data: Training views of the group.
        points: N new static points.
        moving: Dynamic and relit points at the keyframe.
        static: Static points of older layers.
        coding: Encoder of the reel.
    """
    count = len(points)
    seen = Gaussians.concatenate([points, moving, static])
    importance = weigh([seen], data.cameras, data.near, data.antialias)[:count]
    others, moved = seen[count:], len(moving)
    encoded, steps = encode_layer_by_slope(coding.encoder, data, points, others, moved, importance, coding.trial)
    return CompressedLayer.of(data.span, points, importance, steps, encoded)


def compress_group(data: GroupInput, group: Group, static: StaticPoints, coding: Coding) -> CompressedGroup:
    """Encode a finished group, with quantization steps chosen by its images.

    Args:
        data: Training views of the group.
        group: The group.
        static: Static points that it shows.
        coding: Encoder of the reel.
    """
    encoder = coding.encoder
    importance = group_importance(coding.header, encoder.config, static.points, group)[0]
    files, steps = encode_group_by_slope(encoder, data, group, static, importance, coding.trial)
    return CompressedGroup(group, importance, steps, files)
