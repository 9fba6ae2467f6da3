"""Steps of a reconstruction by their names: texts for the user, names of measured seconds, and checkpoints.

`method/algorithm.py` computes the steps of a group, and `run/costs.py` knows the time that each takes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from splatreel.config import Config
from splatreel.method.cameras.exposure import Exposure, at_next_keyframe
from splatreel.method.cameras.rig import Poses, Rig
from splatreel.method.layering.labels import Layers, RelitPoints
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.keyframe_trainer import KeyframeResult
from splatreel.run.store import Arrays, GroupStore, pack, present, unpack

Found = TypeVar("Found")


@dataclass(frozen=True)
class StepCheckpoint(Generic[Found]):
    """File that holds the result of a step.

    Attributes:
        name: Name of the file without its suffix.
        to_arrays: Returns a result as arrays.
        from_arrays: Returns the result that `to_arrays` gave these arrays for.
    """

    name: str
    to_arrays: Callable[[Found], Arrays]
    from_arrays: Callable[[Arrays], Found]

    def load(self, store: GroupStore) -> Found | None:
        """Return the saved result; None where there is none."""
        arrays = store.load(self.name)
        return None if arrays is None else self.from_arrays(arrays)

    def save(self, store: GroupStore, found: Found) -> None:
        """Save a result."""
        store.save(self.name, self.to_arrays(found))


def _pack_keyframe(found: KeyframeResult) -> Arrays:
    return pack(found.points) | {"gains": found.gains} | present(alive=found.alive)


def _unpack_keyframe(arrays: Arrays) -> KeyframeResult:
    return KeyframeResult(unpack(arrays), arrays["gains"], arrays.get("alive"))


def _pack_layers(found: Layers) -> Arrays:
    arrays = {"alive": found.alive, "light": found.relit.light}
    kinds = {"settled": found.new_static, "dynamic": found.dynamic, "relit": found.relit.points}
    for kind, points in kinds.items():
        arrays |= pack(points, f"{kind}_")
    return arrays


def _unpack_layers(arrays: Arrays) -> Layers:
    new_static, dynamic, relit = (unpack(arrays, f"{kind}_") for kind in ("settled", "dynamic", "relit"))
    return Layers(arrays["alive"], new_static, dynamic, RelitPoints(relit, arrays["light"]))


def _pack_tracks(found: GroupStart) -> Arrays:
    return pack(found.dynamic) | present(tracks=found.tracks, shades=found.shades, left=found.departed)


def _unpack_tracks(arrays: Arrays) -> GroupStart:
    return GroupStart(unpack(arrays), arrays.get("tracks"), arrays.get("shades"), arrays.get("left"))


EXPOSURE = StepCheckpoint[Exposure](
    "exposure",
    lambda found: {"change": found.change, "light": found.light},
    lambda arrays: Exposure(arrays["change"], arrays["light"]),
)
POSES = StepCheckpoint[Poses](
    "poses",
    lambda found: {"viewmats": found.viewmats} | present(kept=found.kept),
    lambda arrays: Poses(arrays["viewmats"], arrays.get("kept")),
)
"""Poses of a group. Those of the first group are found before it begins, and may leave cameras out."""
KEYFRAME = StepCheckpoint[KeyframeResult]("keyframe", _pack_keyframe, _unpack_keyframe)
CHAPTER = StepCheckpoint[KeyframeResult]("chapter", _pack_keyframe, _unpack_keyframe)
"""First keyframe of a chapter."""
LAYERS = StepCheckpoint[Layers]("layering", _pack_layers, _unpack_layers)
TRACKS = StepCheckpoint[GroupStart]("tracking", _pack_tracks, _unpack_tracks)
TIME_OFFSETS = StepCheckpoint[np.ndarray]("delays", lambda found: {"delays": found}, lambda arrays: arrays["delays"])
"""Time offsets [C] of the cameras at the end of a group."""


def restored_rig(rig: Rig, store: GroupStore, own: int) -> Rig:
    """Return the cameras after a finished group.

    Args:
        rig: Cameras as the group found them.
        store: Checkpoints of the group.
        own: Number of frames of the group without the overlap.
    """
    poses, exposure, offsets = POSES.load(store), EXPOSURE.load(store), TIME_OFFSETS.load(store)
    keyframe = KEYFRAME.load(store) or CHAPTER.load(store)
    rig = rig if poses is None else rig.with_poses(poses)  # comes first, because it may leave cameras out
    rig = rig if exposure is None else at_next_keyframe(rig, exposure, own)
    rig = rig if keyframe is None else replace(rig, gains=keyframe.gains)
    return rig if offsets is None else rig.with_offsets(offsets)


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
