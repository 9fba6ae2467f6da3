"""Files of the steps of a group: their names, the names of their arrays, and round trips. Runs of earlier revisions have these."""

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.method.cameras.exposure import Exposure
from splatreel.method.cameras.rig import Poses
from splatreel.method.layering.labels import Layers, RelitPoints
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.keyframe_trainer import KeyframeResult
from splatreel.run.checkpoint import FIELDS
from splatreel.run.step_checkpoints import (
    CHAPTER,
    EXPOSURE,
    KEYFRAME,
    LAYERS,
    POSES,
    TIME_OFFSETS,
    TRACKS,
    StepCheckpoint,
)
from splatreel.run.store import GroupStore
from tests.method.test_algorithm import points

RNG = np.random.default_rng(0)
POINTS = points(RNG, 4)
ARRAY = RNG.random((2, 4, 3), np.float32)
ALIVE = np.array([True, False])
KINDS = [f"{kind}_{name}" for kind in ("settled", "dynamic", "relit") for name in FIELDS]
CASES: dict[str, tuple[StepCheckpoint[Any], Any, list[str]]] = {
    "exposure": (EXPOSURE, Exposure(ARRAY, ARRAY[0]), ["change", "light"]),
    "poses": (POSES, Poses(np.eye(4)[None], np.array([1])), ["viewmats", "kept"]),
    "keyframe": (KEYFRAME, KeyframeResult(POINTS, ARRAY[0]), [*FIELDS, "gains"]),
    "chapter": (CHAPTER, KeyframeResult(POINTS, ARRAY[0], ALIVE), [*FIELDS, "gains", "alive"]),
    "layering": (LAYERS, Layers(ALIVE, POINTS, POINTS, RelitPoints(POINTS, ARRAY[0])), ["alive", "light", *KINDS]),
    "tracking": (TRACKS, GroupStart(POINTS, ARRAY, ARRAY, ALIVE), [*FIELDS, "tracks", "shades", "left"]),
    "delays": (TIME_OFFSETS, ARRAY[0, :, 0], ["delays"]),
}


@pytest.mark.parametrize("name", CASES)
def test_arrays_of_checkpoint_keep_their_names(name: str, tmp_path: Path) -> None:
    checkpoint, found, names = CASES[name]
    store = GroupStore(tmp_path)
    assert checkpoint.load(store) is None
    checkpoint.save(store, found)
    arrays = store.load(name)
    assert arrays is not None
    assert set(arrays) == set(names)
    assert_equal(checkpoint.load(store), found)


def assert_equal(value: Any, expected: Any) -> None:
    """Compare results field by field."""
    if is_dataclass(expected):
        for field in fields(expected):
            assert_equal(getattr(value, field.name), getattr(expected, field.name))
    else:
        np.testing.assert_array_equal(value, expected)
