"""The checkpoints of a run, OUT/work: the names of its files and of the arrays in them.

Two files are kept elsewhere: run.json (`run_record`), and the sound (`encode/soundtrack.py`).

Whatever a stage finds is kept as soon as it is found, so that a run can be killed anywhere and continued. What is not there, or not
yet, is loaded as None.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.predictive.precision import STEPS, Steps
from splatreel.codec.presentation import Limits, Presentation, parse_presentation
from splatreel.errors import ReconstructionError
from splatreel.motion.clean_plates import CleanPlates
from splatreel.recon.cameras.exposure import Exposure, at_next_keyframe
from splatreel.recon.cameras.rig import Poses, Rig
from splatreel.recon.coverage.coverage import Coverage
from splatreel.recon.init.layout import Layout
from splatreel.recon.layering.labels import Layers
from splatreel.recon.layering.relighting import RelitPoints
from splatreel.recon.layering.tracking import GroupStart
from splatreel.recon.run import checkpoint
from splatreel.recon.train.chapter_keyframe import ChapterStart
from splatreel.recon.train.keyframe import KeyframeResult
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.untrusted import is_number

LAST_OF_GROUP = "encoded-group.safetensors"
"""The file of a chapter's group that is written last."""
PUBLISHED_OF_GROUP = ("layer.safetensors", "encoded-layer.safetensors", "group.safetensors", LAST_OF_GROUP)
"""What a reel is written from."""
T = TypeVar("T")
Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class StoredLayer:
    """The static points born at a group, in reel order: as trained, and as the reel holds them.

    importance: [N, 3] of each, as the run measured it; None where it did not. steps: quantization steps of their
    file at a coarseness of 1.
    """

    trained: Gaussians
    decoded: Gaussians
    importance: np.ndarray | None = None
    steps: Steps = STEPS


@dataclass(frozen=True)
class StoredGroup:
    """A finished group before encoding. importance, steps: as of a layer, of its dynamic points."""

    group: Group
    importance: np.ndarray | None = None
    steps: Steps = STEPS


class GroupStore:
    """The checkpoints of one group, or of the scene that chapters share.

    encoded: the files of a reel that are made of them, where they are made before the reel is written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def poses(self) -> Poses | None:
        arrays = self._load("poses")
        return None if arrays is None else Poses(arrays["viewmats"], arrays.get("kept"))

    def save_poses(self, poses: Poses) -> None:
        self._save("poses", {"viewmats": poses.viewmats} | _present(kept=poses.kept))

    def exposure(self) -> Exposure | None:
        arrays = self._load("exposure")
        return None if arrays is None else Exposure(arrays["change"], arrays["light"])

    def save_exposure(self, exposure: Exposure) -> None:
        self._save("exposure", {"change": exposure.change, "light": exposure.light})

    def keyframe(self) -> KeyframeResult | None:
        arrays = self._load("keyframe")
        return None if arrays is None else KeyframeResult(checkpoint.unpack(arrays), arrays["gains"])

    def save_keyframe(self, keyframe: KeyframeResult) -> None:
        self._save("keyframe", checkpoint.pack(keyframe.points) | {"gains": keyframe.gains})

    def chapter_start(self) -> ChapterStart | None:
        arrays = self._load("chapter")
        if arrays is None:
            return None
        return ChapterStart(checkpoint.unpack(arrays), arrays["gains"], arrays["alive"])

    def save_chapter_start(self, start: ChapterStart) -> None:
        self._save("chapter", checkpoint.pack(start.points) | {"gains": start.gains, "alive": start.alive})

    def plates(self) -> CleanPlates | None:
        arrays = self._load("plates")
        return None if arrays is None else CleanPlates(arrays["images"], arrays["unknown"])

    def save_plates(self, plates: CleanPlates) -> None:
        self._save("plates", plates._asdict())

    def layers(self) -> Layers | None:
        arrays = self._load("layering")
        if arrays is None:
            return None
        settled, dynamic, relit = (checkpoint.unpack(arrays, f"{kind}_") for kind in ("settled", "dynamic", "relit"))
        return Layers(arrays["alive"], settled, dynamic, RelitPoints(relit, arrays["light"]))

    def save_layers(self, layers: Layers) -> None:
        kinds = {"settled": layers.settled, "dynamic": layers.dynamic, "relit": layers.relit.points}
        arrays = {"alive": layers.alive, "light": layers.relit.light}
        for kind, points in kinds.items():
            arrays |= checkpoint.pack(points, f"{kind}_")
        self._save("layering", arrays)

    def layer(self) -> StoredLayer | None:
        arrays = self._load("layer")
        if arrays is None:
            return None
        trained, decoded = (checkpoint.unpack(arrays, f"{kind}_") for kind in ("raw", "decoded"))
        return StoredLayer(trained, decoded, arrays.get("importance"), _steps(arrays))

    def has_layer(self) -> bool:
        return self._path("layer").exists()

    def save_layer(self, layer: StoredLayer) -> None:
        arrays = checkpoint.pack(layer.trained, "raw_") | checkpoint.pack(layer.decoded, "decoded_")
        self._save("layer", arrays | {"steps": layer.steps.to_array()} | _present(importance=layer.importance))

    def encoded_layer(self) -> bytes | None:
        """The file of `layer`, in whose order it is."""
        arrays = self._load("encoded-layer")
        return None if arrays is None else arrays["file"].tobytes()

    def save_encoded_layer(self, data: bytes) -> None:
        self._save("encoded-layer", {"file": np.frombuffer(data, np.uint8)})

    def encoded_group(self) -> dict[str, bytes] | None:
        """By uri the files of the finished group, the best rendition first."""
        arrays = self._load("encoded-group")
        if arrays is None:
            return None
        order = json.loads(arrays["uris"].tobytes())
        return {uri: arrays[f"file{place}"].tobytes() for place, uri in enumerate(order)}

    def save_encoded_group(self, files: dict[str, bytes]) -> None:
        arrays = {f"file{place}": np.frombuffer(data, np.uint8) for place, data in enumerate(files.values())}
        self._save("encoded-group", arrays | {"uris": np.frombuffer(json.dumps(list(files)).encode(), np.uint8)})

    def has_encoded_group(self) -> bool:
        return self._path("encoded-group").exists()

    def start(self) -> GroupStart | None:
        arrays = self._load("tracking")
        if arrays is None:
            return None
        return GroupStart(checkpoint.unpack(arrays), arrays.get("tracks"), arrays.get("shades"), arrays.get("left"))

    def save_start(self, start: GroupStart) -> None:
        found = _present(tracks=start.tracks, shades=start.shades, left=start.departed)
        self._save("tracking", checkpoint.pack(start.dynamic) | found)

    def time_offsets(self) -> np.ndarray | None:
        """[C] frames, at the end of the group."""
        arrays = self._load("delays")
        return None if arrays is None else arrays["delays"]

    def save_time_offsets(self, offsets: np.ndarray) -> None:
        self._save("delays", {"delays": offsets})

    def forget(self) -> None:
        """Delete what was found but where cameras stand: the group is to be made again. What says that it is finished goes first."""
        for name in ("group", *sorted({file.stem for file in self.folder.glob("*.safetensors")} - {"poses"})):
            self._path(name).unlink(missing_ok=True)

    def finished(self) -> bool:
        return self._path("group").exists()

    def group(self) -> StoredGroup:
        """Raises `ReconstructionError` where the group is not finished."""
        arrays = checkpoint.load_arrays(self._path("group"))
        index, first = int(self.folder.name.removeprefix("group")), int(arrays["first_frame"][0])
        dynamic, alive = checkpoint.unpack(arrays), arrays["alive"].astype(bool)
        shade, light = arrays.get("shade"), arrays.get("light")
        group = Group(index, first, dynamic, arrays["dx"], arrays["dq"], alive, shade, light)
        return StoredGroup(group, arrays.get("importance"), _steps(arrays))

    def save_group(self, stored: StoredGroup) -> None:
        group = stored.group
        arrays = checkpoint.pack(group.dynamic) | {"dx": group.dx, "dq": group.dq, "alive": group.alive}
        arrays |= {"first_frame": np.array([group.first_frame]), "steps": stored.steps.to_array()}
        found = _present(shade=group.shade, light=group.light, importance=stored.importance)
        self._save("group", arrays | found)

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.safetensors"

    def _load(self, name: str) -> Arrays | None:
        return checkpoint.load_arrays(self._path(name)) if self._path(name).exists() else None

    def _save(self, name: str, arrays: Arrays) -> None:
        checkpoint.save_arrays(self._path(name), arrays)


def _steps(arrays: Arrays) -> Steps:
    """Return the steps of a file. Checkpoints of earlier versions have one factor for all steps, or none."""
    if "steps" in arrays:
        return Steps(*arrays["steps"].tolist())
    return STEPS.scaled(float(arrays["fineness"][0])) if "fineness" in arrays else STEPS


class Store:
    """The checkpoints of a whole run."""

    def __init__(self, work: Path) -> None:
        self.work = work

    def group(self, index: int) -> GroupStore:
        return GroupStore(self.work / f"group{index:04d}")

    @property
    def scene(self) -> GroupStore:
        """What chapters share; its folder is there only where there are several."""
        return GroupStore(self.work / "scene")

    @property
    def tables_file(self) -> Path:
        """Frame tables of the capture's videos, so that only one process scans them."""
        return self.work / "frames.safetensors"

    def chapter_firsts(self) -> list[int] | None:
        """The first group of each chapter; None where the video is one, without static points that are shared."""
        path = self.work / "chapters.json"
        return checkpoint.load_checked(path, _firsts) if path.exists() else None

    def save_chapter_firsts(self, firsts: list[int]) -> None:
        checkpoint.save_json(self.work / "chapters.json", firsts)

    def finished_groups(self, first: int = 0) -> int:
        """How many groups, from `first` on, have been reconstructed."""
        index = first
        while self.group(index).finished():
            index += 1
        return index - first

    def layers(self, index: int) -> list[tuple[int, StoredLayer]]:
        """The layers that a group shows points of, in the order of its `alive` bits, each with the group of its birth."""
        firsts = self.chapter_firsts()
        shared = None if firsts is None else self.scene.layer()
        begin = max((first for first in firsts or [0] if first <= index), default=0)
        own = [(i, self.group(i).layer()) for i in range(begin, index + 1)]
        return [(born, layer) for born, layer in [(0, shared), *own] if layer is not None]

    def static(self, index: int) -> Gaussians:
        """The static points of these layers, as the reel holds them."""
        return Gaussians.concatenate([Gaussians.empty(0), *(layer.decoded for _, layer in self.layers(index))])

    def layout(self) -> Layout | None:
        """What the first frame told of the scene, with the points that go with it (`initial_points`)."""
        if not (self._layout.exists() and self._points.exists()):
            return None
        return checkpoint.load_checked(self._layout, Layout.from_dict)

    def initial_points(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions [P, 3] and colors [P, 3] 0..1. Raises `ReconstructionError` where there are none."""
        arrays = checkpoint.load_arrays(self._points)
        return arrays["points"], arrays["colors"]

    def save_layout(self, layout: Layout, points: np.ndarray, colors: np.ndarray) -> None:
        checkpoint.save_arrays(self._points, {"points": points, "colors": colors})
        checkpoint.save_json(self._layout, layout.to_dict())

    def header(self) -> tuple[ReelHeader, Limits | None]:
        """What the reel says beside its files, and how far views hold. Raises `ReconstructionError` where there is none."""
        path = self.work / "header.json"
        if not path.exists():
            raise ReconstructionError(
                f"{self.work}: holds no reconstruction (no header.json). Name the work folder of a run."
            )
        return checkpoint.load_checked(path, _header)

    def save_header(self, header: ReelHeader, limits: Limits | None = None) -> None:
        """So that a reel can be written again from the checkpoints alone."""
        checkpoint.save_json(self.work / "header.json", header.to_dict() | Presentation(limits=limits).to_json())

    def coverage(self) -> Coverage | None:
        """Raises `ReconstructionError` for a damaged file."""
        path = self.work / "coverage.json"
        if not path.exists():
            return None
        return checkpoint.load_checked(path, Coverage.from_dict)

    def save_coverage(self, coverage: Coverage) -> None:
        checkpoint.save_json(self.work / "coverage.json", coverage.to_dict())

    def seconds(self, part: str | None = None) -> dict[str, float]:
        """By stage, summed over the groups and over interrupted runs. part: of a run; None: of all of it."""
        pattern = "seconds*.json" if part is None else self._seconds(part).name
        total: dict[str, float] = {}
        for path in sorted(self.work.glob(pattern)):
            for stage, seconds in checkpoint.load_checked(path, _seconds_of).items():
                total[stage] = total.get(stage, 0.0) + seconds
        return total

    def save_seconds(self, seconds: dict[str, float], part: str = "") -> None:
        checkpoint.save_json(self._seconds(part), seconds)

    def _seconds(self, part: str) -> Path:
        return self.work / f"seconds{part and f'-{part}'}.json"

    @property
    def _layout(self) -> Path:
        return self.work / "layout.json"

    @property
    def _points(self) -> Path:
        return self.work / "points.safetensors"


def restored_rig(rig: Rig, store: GroupStore, own: int) -> Rig:
    """What a finished group found out about the cameras. own: its frames that are not the next one's, too."""
    if (poses := store.poses()) is not None:
        rig = rig.standing(poses)
    if (keyframe := store.keyframe()) is not None:
        rig = replace(rig, gains=keyframe.gains)
    if (start := store.chapter_start()) is not None:
        rig = replace(rig, gains=start.gains)
    if (exposure := store.exposure()) is not None:
        rig = at_next_keyframe(rig, exposure, own)
    if (offsets := store.time_offsets()) is not None:
        rig = rig.timed(offsets)
    return rig


def once(load: Callable[[], T | None], find: Callable[[], T], save: Callable[[T], None]) -> T:
    """What was found before; else it is found now, and kept."""
    found = load()
    if found is None:
        found = find()
        save(found)
    return found


def _firsts(value: Any) -> list[int]:
    if not isinstance(value, list) or not all(type(first) is int and first >= 0 for first in value):
        raise TypeError("expected numbers of groups")
    return value


def _header(plain: Any) -> tuple[ReelHeader, Limits | None]:
    return ReelHeader.from_dict(plain), parse_presentation({"limits": plain.get("limits")}).limits


def _seconds_of(value: Any) -> dict[str, float]:
    if not isinstance(value, dict) or not all(is_number(seconds) for seconds in value.values()):
        raise TypeError("expected seconds by stage")
    return value


def _present(**arrays: np.ndarray | None) -> Arrays:
    """Those that are there."""
    return {name: array for name, array in arrays.items() if array is not None}
