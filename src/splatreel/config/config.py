"""All settings together."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from typing import Annotated

from splatreel.config.encode import EncodeConfig
from splatreel.config.group import GroupConfig
from splatreel.config.keyframe import KeyframeConfig
from splatreel.config.layering import LayeringConfig
from splatreel.config.values import Range, check


@dataclass(frozen=True)
class Config:
    """Everything that decides what a reconstruction looks like.

    As it stands here it is `--quality standard`. It is plain data, written next to the checkpoints, so that a run continued by the same
    command can tell that it is the same run. Raises `UsageError` for numbers that no run can have.
    """

    layering: LayeringConfig = field(default_factory=LayeringConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    group: GroupConfig = field(default_factory=GroupConfig)
    encode: EncodeConfig = field(default_factory=EncodeConfig)
    correct_colors: bool = True
    """A color gain of each camera, learned on the training cameras around a mean of one; cameras never seen get none."""
    check_poses: bool = True
    """Cameras that were touched after their calibration are put right, and those that show something else left out."""
    check_coverage: bool = True
    """Try with a camera left out what new views will be like, before anything is trained; where they do not hold, the reel says so."""
    even_exposure: bool = True
    """What a camera's exposure does over time, and the light of the whole scene, is taken out of the images before anything looks at
    them. The light comes back when the reel is played."""
    antialias: bool = True
    """Splats thinner than a pixel are drawn fainter (Mip-Splatting): images of any size look alike."""
    background: bool = True
    """Where nothing is known is the color of the images' borders, not black."""
    training_megapixels: Annotated[float, Range(0)] = 0.7
    """Of images larger than this, only so many iterations look at full size that they look at so many million pixels in the mean,
    as many at half size, and so on: what is beside a pixel tells nearly the same. 0: all but coarse ones look at full size."""
    chapter_frames: Annotated[int, Range(0)] = 300
    """Frames of a chapter. A video longer than one and a half of these gets static points that are common to all of it, and its
    chapters start from them each on its own, on as many machines as there are. 0: one chapter, however long."""
    seed: Annotated[int, Range(0)] = 0
    """Of everything random."""

    def __post_init__(self) -> None:
        check(self, "")

    def to_json(self) -> str:
        return json.dumps(dataclasses.asdict(self), indent=1, sort_keys=True)
