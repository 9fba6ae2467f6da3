"""From checkpoints to reels: publish a finished group, re-encode a whole reconstruction, and look at it without encoding."""

from __future__ import annotations

import dataclasses
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from splatreel.codec.manifest import BLACK, Manifest
from splatreel.codec.presentation import Presentation, parse_presentation
from splatreel.codec.reader import ReelReader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.errors import ReconstructionError, UsageError
from splatreel.progress import Progress
from splatreel.recon.encode.importance import weigh
from splatreel.recon.encode.sound import publish_sound
from splatreel.recon.run import checkpoint
from splatreel.recon.run.device import pick_device
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import NONE, Clearance
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

TRIALS = 12
"""Encodings that `meet_rate` tries."""
MOST_WORKERS = 8
"""Groups encoded at a time: each is held in memory."""
MOMENTS, VIEWS = 32, 2
"""Times of a group at which the importance of its points is looked at, and pictures at each: what shows for a few frames shows."""

Present = Callable[[ReelWriter, int | None], None]
"""What a reel has beside its points, such as a poster, is added by what is called after each group with the group's index, and at
the end, before the reel is declared complete, with None."""


def nothing_more(writer: ReelWriter, group: int | None) -> None:
    """Adds nothing."""


def group_folder(work: Path, index: int) -> Path:
    return work / f"group{index:04d}"


def finished_groups(work: Path) -> int:
    """How many groups, from the first on, have been reconstructed."""
    index = 0
    while (group_folder(work, index) / "group.safetensors").exists():
        index += 1
    return index


def load_layer(work: Path, index: int, kind: str) -> Gaussians | None:
    """The static points born at a group, as trained (`raw`) or as the reel holds them (`decoded`); None if none were."""
    path = group_folder(work, index) / "layer.safetensors"
    return checkpoint.unpack(checkpoint.load_arrays(path), kind + "_") if path.exists() else None


def load_static(work: Path, index: int) -> Gaussians:
    """All static points born up to a group, as the reel holds them, in the order that training saw them."""
    layers = [load_layer(work, i, "decoded") for i in range(index + 1)]
    return Gaussians.concatenate([Gaussians.empty(0), *[layer for layer in layers if layer is not None]])


def load_importance(work: Path, index: int, kind: str) -> np.ndarray | None:
    """Of the points of a `layer`, or the dynamic ones of a `group`, as the run encoded it; None where it did not."""
    path = group_folder(work, index) / f"{kind}.safetensors"
    return checkpoint.load_arrays(path).get("importance") if path.exists() else None


def load_group(work: Path, index: int) -> Group:
    """A finished group before encoding."""
    arrays = checkpoint.load_arrays(group_folder(work, index) / "group.safetensors")
    first = int(arrays["first_frame"][0])
    alive = arrays["alive"].astype(bool)
    dynamic, shade, light = checkpoint.unpack(arrays), arrays.get("shade"), arrays.get("light")
    return Group(index, first, dynamic, arrays["dx"], arrays["dq"], alive, shade, light)


def save_group(work: Path, group: Group, importance: np.ndarray | None = None) -> None:
    """importance: [N, 3] of its dynamic points, so that encoding it again takes no pictures."""
    arrays = checkpoint.pack(group.dynamic) | {"dx": group.dx, "dq": group.dq, "alive": group.alive}
    arrays["first_frame"] = np.array([group.first_frame])
    arrays |= {name: value for name in ("shade", "light") if (value := getattr(group, name)) is not None}
    if importance is not None:
        arrays["importance"] = importance
    checkpoint.save_arrays(group_folder(work, group.index) / "group.safetensors", arrays)


def save_header(work: Path, header: dict) -> None:
    """Keep what a manifest says beside its files, so that a reel can be written again from the checkpoints alone."""
    cameras = [_camera_to_dict(camera) for camera in header["cameras"]]
    plain = header | {"cameras": cameras, "camera": _camera_to_dict(header["camera"])}
    plain["clearance"] = header.get("clearance", NONE).to_dict()
    plain |= Presentation(limits=plain.pop("limits", None)).to_json()
    checkpoint.save_json(work / "header.json", plain)


def open_writer(work: Path, reel: Path, config: EncodeConfig, resume: bool) -> ReelWriter:
    """A writer for a reconstruction's reel. Raises `ReconstructionError` if work holds none."""
    path = work / "header.json"
    if not path.exists():
        raise ReconstructionError(f"{work}: holds no reconstruction (no header.json). Name the work folder of a run.")
    header = checkpoint.load_json(path)
    header["cameras"] = [_camera_from_dict(c) for c in header["cameras"]]
    header["camera"] = _camera_from_dict(header["camera"])
    header["bounds"], header["up"] = np.array(header["bounds"]), np.array(header["up"])
    header["background"] = tuple(header.get("background", BLACK))
    header["clearance"] = Clearance.from_dict(header.get("clearance"))
    limits = parse_presentation({"limits": header.pop("limits", None)}).limits
    writer = ReelWriter(reel, config=config, resume=resume, **header)
    if limits != writer.manifest.presentation.limits:
        writer.present(dataclasses.replace(writer.manifest.presentation, limits=limits))
    publish_sound(work, writer)
    return writer


Shown = tuple[np.ndarray | None, np.ndarray | None]
Shows = dict[int, Shown]
"""By group the importance of its dynamic points and of all static points so far."""


def importance(writer: ReelWriter, static: Gaussians, group: Group, device: torch.device) -> Shown:
    """What `weigh` says of a group's dynamic points, and of all static points so far, decoded and in the order of training.

    None where the writer's codec has no use for it; nothing for static points that are not alive.
    """
    config = writer.config
    if config.codec == "h265" and not (config.h265.weighted_codebook and config.sh_entries):
        return None, None
    times = np.linspace(0, group.frames - 1, min(MOMENTS, group.frames))
    moments = (Gaussians.concatenate([group.at(time), static[group.alive]]) for time in times)
    manifest = writer.manifest
    found = weigh(moments, list(manifest.cameras), manifest.near, device, manifest.antialias, VIEWS)
    resting = np.zeros((len(static), 3), np.float32)
    resting[group.alive] = found[len(group.dynamic) :]
    return found[: len(group.dynamic)], resting


@dataclass(frozen=True)
class Ready:
    """A group on its way: with the importance of its points, and the layer born at it with its file."""

    group: Group
    shown: np.ndarray | None
    layer: Gaussians | None
    encoded: tuple[bytes, np.ndarray] | None


class Publisher:
    """Encodes finished groups from their checkpoints, in order from the first.

    device: where importance is measured that no checkpoint has. shows: importance by group, kept from trial to trial.
    """

    def __init__(self, writer: ReelWriter, work: Path, device: torch.device, shows: Shows | None = None) -> None:
        self.writer, self.work, self.device = writer, work, device
        self._shows = {} if shows is None else shows
        self._order = np.zeros(0, np.int64)

    def publish(self, index: int) -> None:
        self._write(self._prepare(index), None)

    def publish_all(self, count: int, done: Callable[[int], None]) -> None:
        """The first `count` groups; several are encoded at a time, in threads, by the predictive codec. done: called with how many."""
        workers = min(os.cpu_count() or 1, MOST_WORKERS) if self.writer.config.codec == "predictive" else 1
        waiting: deque[tuple[Ready, Future[dict[str, bytes]]]] = deque()
        with ThreadPoolExecutor(workers) as pool:
            for index in range(count):
                ready = self._prepare(index)
                waiting.append((ready, pool.submit(self.writer.encode_group, ready.group, ready.shown)))
                while len(waiting) > (workers if index + 1 < count else 0):
                    before, files = waiting.popleft()
                    self._write(before, files.result())
                    done(before.group.index + 1)

    def _prepare(self, index: int) -> Ready:
        group, layer = load_group(self.work, index), load_layer(self.work, index, "raw")
        moving, resting = self._importance(index, group, layer is None)
        encoded = None
        if layer is not None:
            born = load_importance(self.work, index, "layer")
            born = resting[-len(layer) :] if born is None and resting is not None else born
            encoded = self.writer.encode_layer(index, group.first_frame, layer, born)
            self._order = np.concatenate([self._order, len(self._order) + encoded[1]])
        # The alive bits count in the order that training saw; another encoder may have put the points into another order.
        return Ready(dataclasses.replace(group, alive=group.alive[self._order]), moving, layer, encoded)

    def _importance(self, index: int, group: Group, no_layer: bool) -> Shown:
        """As the run measured it, or measured now."""
        saved = load_importance(self.work, index, "group")
        if saved is not None and (no_layer or load_importance(self.work, index, "layer") is not None):
            return saved, None
        if index not in self._shows:
            self._shows[index] = importance(self.writer, load_static(self.work, index), group, self.device)
        return self._shows[index]

    def _write(self, ready: Ready, files: dict[str, bytes] | None) -> None:
        if ready.layer is not None:
            first = ready.group.first_frame
            self.writer.add_layer(ready.group.index, first, ready.layer, encoded=ready.encoded)
        self.writer.add_group(ready.group, ready.shown, files)

    def skip(self, index: int) -> None:
        """A group that the reel holds already, in the order of its checkpoint."""
        born = load_layer(self.work, index, "raw")
        self._order = np.concatenate([self._order, len(self._order) + np.arange(0 if born is None else len(born))])


def encode(
    work: Path,
    reel: Path,
    config: EncodeConfig,
    progress: Progress,
    mbps: float | None = None,
    present: Present = nothing_more,
) -> Path:
    """Write a reel from the checkpoints of a reconstruction, without training; returns the reel's folder.

    mbps: megabits a second of video that the reel shall have; its coarseness is then found by trying. present: adds what is there
    beside the points, at the end.
    """
    count = finished_groups(work)
    if count == 0:
        raise ReconstructionError(f"{work}: holds no finished group. Run splatreel reconstruct first.")
    shows: Shows = {}
    device = pick_device("auto")
    writer: ReelWriter | None = None

    def write(coarseness: float) -> float:
        nonlocal writer
        writer = open_writer(work, reel, dataclasses.replace(config, coarseness=coarseness), resume=False)
        publisher = Publisher(writer, work, device, shows)
        progress.stage("writing the groups", count)
        publisher.publish_all(count, progress.update)
        manifest = writer.manifest
        size = sum(file.bytes for file in (*manifest.layers, *manifest.groups))
        return 8e-6 * size / (manifest.frames / manifest.fps)

    if mbps is None:
        write(config.coarseness)
    else:
        meet_rate(write, mbps)
    assert writer is not None
    present(writer, None)
    writer.finish()
    return reel


def meet_rate(write: Callable[[float], float], mbps: float) -> float:
    """Call `write` with other coarsenesses until the rate it returns is within 5 % of mbps; returns the last coarseness.

    Raises `UsageError` where no coarseness has that rate.
    """
    low, high, rate = -6.0, 8.0, 0.0
    for _ in range(TRIALS):
        octave = (low + high) / 2
        rate = write(2.0**octave)
        if abs(rate / mbps - 1) <= 0.05:
            return 2.0**octave
        low, high = (octave, high) if rate > mbps else (low, octave)
    raise UsageError(
        f"{mbps:g} Mbit/s cannot be met: the nearest tried has {rate:.3g}. Ask for another rate, or train other points."
    )


class UncompressedReel:
    """The reconstruction as it was before any encoding, in the shape of a reel reader: what compression is compared with."""

    def __init__(self, work: Path, reel: Path) -> None:
        reader = ReelReader(reel)
        self.work = work
        self.manifest: Manifest = reader.manifest
        self.fps, self.frames, self.duration, self.name = reader.fps, reader.frames, reader.duration, str(work)

    def group(self, index: int) -> Group:
        return load_group(self.work, index)

    def static(self, group: int) -> tuple[Gaussians, np.ndarray]:
        """All static points born up to a group, as trained, and the group each was born at."""
        layers = {i: load_layer(self.work, i, "raw") for i in range(group + 1)}
        points = {i: layer for i, layer in layers.items() if layer is not None}
        if not points:
            return Gaussians.empty(0), np.zeros(0, np.int64)
        born = np.repeat(list(points), [len(p) for p in points.values()])
        return Gaussians.concatenate(list(points.values())), born


def _camera_to_dict(camera: Camera) -> dict:
    return {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "K": camera.K.tolist(),
        "viewmat": camera.viewmat.tolist(),
    }


def _camera_from_dict(value: dict) -> Camera:
    return Camera(value["name"], np.array(value["viewmat"]), np.array(value["K"]), value["width"], value["height"])
