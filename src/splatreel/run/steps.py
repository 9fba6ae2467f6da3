"""Steps of a reconstruction by their names: texts for the user, names of measured seconds, and checkpoints.

`method/algorithm.py` computes the steps of a group, and `run/estimate.py` knows the time that each takes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from splatreel.config import Config
from splatreel.method.layering.labels import Layers
from splatreel.method.tracking.tracking import GroupStart
from splatreel.run.step_checkpoints import (
    CHAPTER,
    EXPOSURE,
    KEYFRAME,
    LAYERS,
    POSES,
    TRACKS,
    StepCheckpoint,
)


def _one(config: Config, frames: int) -> int:
    return 1


@dataclass(frozen=True)
class Step:
    """A step of a reconstruction.

    Attributes:
        timing: Key of its seconds. Several steps may share one.
        label: Name in an estimate of the seconds.
        text: Text of the progress display; empty for a step that is not shown.
        steps: Number of steps of the progress bar, of the settings and the frames of the group.
        numbers: Numbers that the progress display shows at the end, of the result and the arguments of the step. None if the
            step itself reports its end.
        checkpoint: File of the result; None for a step that is always executed.
        trains: True if the step trains on the GPU where there is one.
    """

    timing: str
    label: str
    text: str = ""
    steps: Callable[[Config, int], int] = _one
    numbers: Callable[..., dict[str, float]] | None = None
    checkpoint: StepCheckpoint[Any] | None = None
    trains: bool = False


def _first_iterations(config: Config, frames: int) -> int:
    return config.keyframe.first_iterations


def _refine_iterations(config: Config, frames: int) -> int:
    return config.keyframe.refine_iterations


def _iterations(config: Config, frames: int) -> int:
    return config.group.iterations_per_frame * frames


def _layer_numbers(found: Layers, *_: object) -> dict[str, float]:
    lit = {"lit": len(found.relit)} if len(found.relit) else {}
    return {"moving": len(found.dynamic), "static": len(found.new_static) + int(found.alive.sum()), **lit}


def _track_numbers(found: GroupStart, data: object, layers: Layers, *_: object) -> dict[str, float]:
    return {"moving": len(found.dynamic), "appeared": len(found.dynamic) - len(layers.dynamic) - len(layers.relit)}


_CAMERAS, _KEYFRAMES, _ENCODING = "exposures and poses", "keyframes", "encoding"
_POINTS, _LAYERING = "placing the initial points", "separating static from moving points"
_TRACKING, _MOTION = "tracking moving points", "training the motion"

STEPS = {
    "points": Step("points", _POINTS, _POINTS),
    "exposure": Step("exposure", _CAMERAS, checkpoint=EXPOSURE),
    "even exposures": Step("exposure", _CAMERAS),
    "poses": Step("poses", _CAMERAS, checkpoint=POSES),
    "scene keyframe": Step(
        "keyframe",
        _KEYFRAMES,
        "training the scene that all chapters share",
        _first_iterations,
        checkpoint=KEYFRAME,
        trains=True,
    ),
    "first keyframe": Step(
        "keyframe", _KEYFRAMES, "training the first keyframe", _first_iterations, checkpoint=KEYFRAME, trains=True
    ),
    "chapter keyframe": Step(
        "keyframe",
        _KEYFRAMES,
        "training the first keyframe of the chapter",
        _first_iterations,
        lambda found, *_: {"points": len(found.points)},
        CHAPTER,
        trains=True,
    ),
    "keyframe": Step(
        "keyframe", _KEYFRAMES, "training the keyframe", _refine_iterations, checkpoint=KEYFRAME, trains=True
    ),
    "layering": Step("layering", _LAYERING, _LAYERING, numbers=_layer_numbers, checkpoint=LAYERS),
    "layer": Step(
        "encode", _ENCODING, "encoding static points", numbers=lambda found, *_: {"points": len(found.decoded)}
    ),
    "tracking": Step("tracking", _TRACKING, _TRACKING, lambda config, frames: frames, _track_numbers, TRACKS),
    "motion": Step(
        "group", _MOTION, _MOTION, _iterations, lambda found, *_: {"moving": len(found.dynamic)}, trains=True
    ),
    "encode": Step("encode", _ENCODING, "encoding the group", numbers=lambda found, *_: {}),
}
"""All steps in their order. "motion", "layer" and "encode" have no checkpoint here: the output saves layers and groups."""
