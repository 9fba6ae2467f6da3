"""Checkpoints of a run, OUT/work: the names of the files and of the arrays in them.

Each result is saved as soon as it is computed, whole or not at all, so that a run can be killed at any time and continued. Loading a
result that is not there returns None. Two files are kept elsewhere: run.json (`run_folder`) and the sound (`encode/soundtrack.py`).
`steps.py` names the files of the steps of a group.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import ReconstructionError, SplatreelError
from splatreel.base.untrusted import is_number, read_json
from splatreel.codec.header import ReelHeader
from splatreel.codec.predictive.precision import STEPS, Steps
from splatreel.codec.presentation import Limits, Presentation, parse_presentation
from splatreel.method.init.layout import Layout
from splatreel.method.prediction.quality import Coverage
from splatreel.method.prediction.trial import Trial
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

T = TypeVar("T")
Arrays = dict[str, np.ndarray]
FIELDS = ("means", "quats", "scales", "opacities", "sh")
NUMBERS = (*FIELDS, "fineness", "importance", "tracks", "shades")
"""Ends of the names of arrays that never hold NaN. Other arrays use NaN for unknown values."""


def save_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write arrays to a safetensors file.

    Raises:
        StorageError: The disk is full or cannot be written.
    """
    write_bytes(path, save({name: np.ascontiguousarray(value) for name, value in arrays.items()}))


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a safetensors file.

    Raises:
        ReconstructionError: The file cannot be read, or holds NaN where it must not.
    """
    try:
        arrays = load_file(str(path))
    except (OSError, SafetensorError) as error:
        raise ReconstructionError(f"{path}: cannot read this checkpoint ({error}). Delete it and run again.") from error
    for name, array in arrays.items():
        if name.rpartition("_")[2] in NUMBERS and array.dtype.kind == "f" and np.isnan(array).any():
            raise ReconstructionError(
                f"{path}: {name} holds {int(np.isnan(array).sum()):,} NaN values: this checkpoint is damaged. "
                "Delete it and run again."
            )
    return arrays


def present(**arrays: np.ndarray | None) -> Arrays:
    """Return the arrays that are not None."""
    return {name: array for name, array in arrays.items() if array is not None}


def pack(gaussians: Gaussians, prefix: str = "") -> dict[str, np.ndarray]:
    """Return Gaussians as arrays. `prefix` is put before each name."""
    return {prefix + name: getattr(gaussians, name) for name in FIELDS}


def unpack(arrays: dict[str, np.ndarray], prefix: str = "") -> Gaussians:
    """Return the Gaussians that `pack` gave these arrays for."""
    return Gaussians(*(arrays[prefix + name] for name in FIELDS))


def save_json(path: Path, value: Any) -> None:
    """Write a JSON file.

    Raises:
        StorageError: The disk is full or cannot be written.
    """
    write_bytes(path, (json.dumps(value, indent=1, sort_keys=True) + "\n").encode())


def load_json(path: Path) -> Any:
    """Return the value of a JSON file.

    Raises:
        ReconstructionError: The file cannot be read.
    """
    try:
        return read_json(path, ReconstructionError)
    except ReconstructionError as error:
        raise ReconstructionError(f"{error} This checkpoint cannot be read: delete it and run again.") from error


def load_checked(path: Path, decode: Callable[[Any], T]) -> T:
    """Return the decoded value of a JSON file.

    Args:
        path: The file.
        decode: Takes the value. It may raise any error that a value of an unexpected type causes.

    Raises:
        ReconstructionError: The file cannot be read, or `decode` failed.
    """
    value = load_json(path)
    try:
        return decode(value)
    except (TypeError, ValueError, KeyError, AttributeError, IndexError, OverflowError, SplatreelError) as error:
        raise ReconstructionError(f"{path}: is damaged ({error!r:.200}). Delete the folder to start over.") from error


LAST_OF_GROUP = "encoded-group.safetensors"
"""File of a chapter's group that is written last."""
REEL_FILES_OF_GROUP = ("layer.safetensors", "encoded-layer.safetensors", "group.safetensors", LAST_OF_GROUP)
"""Files of a group that a reel is written from."""


@dataclass(frozen=True)
class StoredLayer:
    """The static points that a group added, in the order of the reel.

    Attributes:
        trained: Points [N] as trained.
        decoded: The same points as the reel holds them.
        importance: Importance [N, 3] as the run measured it; None where it was not measured.
        steps: Quantization steps of the layer's file at a coarseness of 1.
    """

    trained: Gaussians
    decoded: Gaussians
    importance: np.ndarray | None = None
    steps: Steps = STEPS


@dataclass(frozen=True)
class StoredGroup:
    """A finished group before encoding.

    Attributes:
        importance: Importance [N, 3] of its dynamic points; None where it was not measured.
        steps: Quantization steps of the group's file at a coarseness of 1.
    """

    group: Group
    importance: np.ndarray | None = None
    steps: Steps = STEPS


class GroupStore:
    """Checkpoints of one group, or of the scene that chapters share."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def load(self, name: str) -> Arrays | None:
        """Return the arrays of a checkpoint; None where there is none."""
        path = self._path(name)
        return load_arrays(path) if path.exists() else None

    def save(self, name: str, arrays: Arrays) -> None:
        """Write a checkpoint."""
        save_arrays(self._path(name), arrays)

    def layer(self) -> StoredLayer | None:
        """Return the static points that the group added."""
        arrays = self.load("layer")
        if arrays is None:
            return None
        trained, decoded = (unpack(arrays, f"{kind}_") for kind in ("raw", "decoded"))
        return StoredLayer(trained, decoded, arrays.get("importance"), _steps(arrays))

    def has_layer(self) -> bool:
        """Return True if the group has saved its layer."""
        return self._path("layer").exists()

    def save_layer(self, layer: StoredLayer) -> None:
        """Save the static points that the group added."""
        arrays = pack(layer.trained, "raw_") | pack(layer.decoded, "decoded_")
        self.save("layer", arrays | {"steps": layer.steps.to_array()} | present(importance=layer.importance))

    def encoded_layer(self) -> tuple[bytes, ...] | None:
        """Return the files of the layer's parts, with its points in the same order."""
        arrays = self.load("encoded-layer")
        return None if arrays is None else tuple(arrays[_part(part)].tobytes() for part in range(len(arrays)))

    def save_encoded_layer(self, files: Sequence[bytes]) -> None:
        """Save the files of the layer's parts."""
        self.save("encoded-layer", {_part(part): np.frombuffer(data, np.uint8) for part, data in enumerate(files)})

    def encoded_group(self) -> dict[str, bytes] | None:
        """Return the files of the finished group by uri, the best rendition first."""
        arrays = self.load("encoded-group")
        if arrays is None:
            return None
        order = json.loads(arrays["uris"].tobytes())
        return {uri: arrays[f"file{place}"].tobytes() for place, uri in enumerate(order)}

    def save_encoded_group(self, files: dict[str, bytes]) -> None:
        """Save the files of the finished group."""
        arrays = {f"file{place}": np.frombuffer(data, np.uint8) for place, data in enumerate(files.values())}
        self.save("encoded-group", arrays | {"uris": np.frombuffer(json.dumps(list(files)).encode(), np.uint8)})

    def has_encoded_group(self) -> bool:
        """Return True if the group is encoded."""
        return self._path("encoded-group").exists()

    def forget(self) -> None:
        """Delete all results but the poses, so that the group is reconstructed again. The file that marks it as finished goes first."""
        for name in ("group", *sorted({file.stem for file in self.folder.glob("*.safetensors")} - {"poses"})):
            self._path(name).unlink(missing_ok=True)

    def finished(self) -> bool:
        """Return True if the group is reconstructed."""
        return self._path("group").exists()

    def group(self) -> StoredGroup:
        """Return the finished group.

        Raises:
            ReconstructionError: The group is not finished.
        """
        arrays = load_arrays(self._path("group"))
        index, first = int(self.folder.name.removeprefix("group")), int(arrays["first_frame"][0])
        dynamic, alive = unpack(arrays), arrays["alive"].astype(bool)
        shade, light = arrays.get("shade"), arrays.get("light")
        group = Group(index, first, dynamic, arrays["dx"], arrays["dq"], alive, shade, light)
        return StoredGroup(group, arrays.get("importance"), _steps(arrays))

    def save_group(self, stored: StoredGroup) -> None:
        """Save the finished group."""
        group = stored.group
        arrays = pack(group.dynamic) | {"dx": group.dx, "dq": group.dq, "alive": group.alive}
        arrays |= {"first_frame": np.array([group.first_frame]), "steps": stored.steps.to_array()}
        found = present(shade=group.shade, light=group.light, importance=stored.importance)
        self.save("group", arrays | found)

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.safetensors"


def _part(number: int) -> str:
    """Return the name of the array that holds a part's file. Older checkpoints have a single file."""
    return f"file{number}" if number else "file"


def _steps(arrays: Arrays) -> Steps:
    """Return the steps of a file. Older checkpoints have one factor for all steps, or none."""
    if "steps" in arrays:
        return Steps(*arrays["steps"].tolist())
    return STEPS.scaled(float(arrays["fineness"][0])) if "fineness" in arrays else STEPS


class Store:
    """Checkpoints of a whole run."""

    def __init__(self, work: Path) -> None:
        self.work = work

    def group(self, index: int) -> GroupStore:
        """Return the checkpoints of a group."""
        return GroupStore(self.work / f"group{index:04d}")

    @property
    def scene(self) -> GroupStore:
        """Checkpoints of the scene that chapters share. The folder exists only for a video of several chapters."""
        return GroupStore(self.work / "scene")

    @property
    def tables_file(self) -> Path:
        """Frame tables of the capture's videos, so that only one process scans them."""
        return self.work / "frames.safetensors"

    def chapter_firsts(self) -> list[int] | None:
        """Return the first group of each chapter; None for a video of one chapter, which shares no scene."""
        path = self.work / "chapters.json"
        return load_checked(path, _firsts) if path.exists() else None

    def save_chapter_firsts(self, firsts: list[int]) -> None:
        """Save the first group of each chapter."""
        save_json(self.work / "chapters.json", firsts)

    def finished_groups(self, first: int = 0) -> int:
        """Return the number of groups that are reconstructed without a gap, counted from group `first`."""
        index = first
        while self.group(index).finished():
            index += 1
        return index - first

    def layers(self, index: int) -> list[tuple[int, StoredLayer]]:
        """Return the layers that a group shows, each with the group that added it, in the order of `alive`."""
        firsts = self.chapter_firsts()
        shared = None if firsts is None else self.scene.layer()
        begin = max((first for first in firsts or [0] if first <= index), default=0)
        own = [(i, self.group(i).layer()) for i in range(begin, index + 1)]
        return [(born, layer) for born, layer in [(0, shared), *own] if layer is not None]

    def static(self, index: int) -> Gaussians:
        """Return the static points of these layers, as the reel holds them."""
        return Gaussians.concatenate([Gaussians.empty(0), *(layer.decoded for _, layer in self.layers(index))])

    def layout(self) -> Layout | None:
        """Return the measures of the scene; None unless the initial points are saved with them."""
        if not (self._layout.exists() and self._points.exists()):
            return None
        return load_checked(self._layout, Layout.from_dict)

    def initial_points(self) -> tuple[np.ndarray, np.ndarray]:
        """Return positions [P, 3] and colors [P, 3] 0..1.

        Raises:
            ReconstructionError: There are none.
        """
        arrays = load_arrays(self._points)
        return arrays["points"], arrays["colors"]

    def save_layout(self, layout: Layout, points: np.ndarray, colors: np.ndarray) -> None:
        """Save the measures of the scene and the initial points."""
        save_arrays(self._points, {"points": points, "colors": colors})
        save_json(self._layout, layout.to_dict())

    def header(self) -> tuple[ReelHeader, Limits | None]:
        """Return the header of the reel, and how far views hold.

        Raises:
            ReconstructionError: The folder holds no reconstruction.
        """
        path = self.work / "header.json"
        if not path.exists():
            raise ReconstructionError(
                f"{self.work}: holds no reconstruction (no header.json). Name the work folder of a run."
            )
        return load_checked(path, _header)

    def save_header(self, header: ReelHeader, limits: Limits | None = None) -> None:
        """Save the header of the reel, so that a reel can be written from the checkpoints alone."""
        save_json(self.work / "header.json", header.to_dict() | Presentation(limits=limits).to_json())

    def coverage(self) -> Coverage | None:
        """Return how well the cameras cover the scene.

        Raises:
            ReconstructionError: The file is damaged.
        """
        path = self.work / "coverage.json"
        if not path.exists():
            return None
        return load_checked(path, Coverage.from_dict)

    def trial(self) -> Trial | None:
        """Return the result of the trial that left a camera out; None where no trial was made."""
        coverage = self.coverage()
        return coverage and coverage.trial

    def save_coverage(self, coverage: Coverage) -> None:
        """Save how well the cameras cover the scene."""
        save_json(self.work / "coverage.json", coverage.to_dict())

    def seconds(self, part: str | None = None) -> dict[str, float]:
        """Return seconds by stage, summed over groups and interrupted runs.

        Args:
            part: A part of the run, such as chapter0003; None for the sum of all parts.
        """
        pattern = "seconds*.json" if part is None else self._seconds(part).name
        total: dict[str, float] = {}
        for path in sorted(self.work.glob(pattern)):
            for stage, seconds in load_checked(path, _seconds_of).items():
                total[stage] = total.get(stage, 0.0) + seconds
        return total

    def save_seconds(self, seconds: dict[str, float], part: str = "") -> None:
        """Save the seconds of a part of the run."""
        save_json(self._seconds(part), seconds)

    def _seconds(self, part: str) -> Path:
        return self.work / f"seconds{part and f'-{part}'}.json"

    @property
    def _layout(self) -> Path:
        return self.work / "layout.json"

    @property
    def _points(self) -> Path:
        return self.work / "points.safetensors"


def _firsts(value: Any) -> list[int]:
    if not isinstance(value, list) or not all(type(first) is int and first >= 0 for first in value):
        raise TypeError("expected indices of groups")
    return value


def _header(plain: Any) -> tuple[ReelHeader, Limits | None]:
    return ReelHeader.from_dict(plain), parse_presentation({"limits": plain.get("limits")}).limits


def _seconds_of(value: Any) -> dict[str, float]:
    if not isinstance(value, dict) or not all(is_number(seconds) for seconds in value.values()):
        raise TypeError("expected seconds by stage")
    return value
