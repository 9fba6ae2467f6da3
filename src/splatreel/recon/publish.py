"""From checkpoints to reels: publish a finished group, re-encode a whole reconstruction, and look at it without encoding."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.errors import ReconstructionError
from splatreel.progress import Progress
from splatreel.recon import checkpoint
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


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


def load_group(work: Path, index: int) -> Group:
    """A finished group before encoding."""
    arrays = checkpoint.load_arrays(group_folder(work, index) / "group.safetensors")
    first = int(arrays["first_frame"][0])
    alive = arrays["alive"].astype(bool)
    return Group(index, first, checkpoint.unpack(arrays), arrays["dx"], arrays["dq"], alive)


def save_group(work: Path, group: Group) -> None:
    arrays = checkpoint.pack(group.dynamic) | {"dx": group.dx, "dq": group.dq, "alive": group.alive}
    arrays["first_frame"] = np.array([group.first_frame])
    checkpoint.save_arrays(group_folder(work, group.index) / "group.safetensors", arrays)


def save_header(work: Path, header: dict) -> None:
    """Keep what a manifest says beside its files, so that a reel can be written again from the checkpoints alone."""
    cameras = [_camera_to_dict(camera) for camera in header["cameras"]]
    plain = header | {"cameras": cameras, "camera": _camera_to_dict(header["camera"])}
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
    return ReelWriter(reel, config=config, resume=resume, **header)


class Publisher:
    """Encodes finished groups from their checkpoints, in order from the first."""

    def __init__(self, writer: ReelWriter, work: Path) -> None:
        self.writer, self.work = writer, work
        self._order = np.zeros(0, np.int64)

    def publish(self, index: int) -> None:
        group, layer = load_group(self.work, index), load_layer(self.work, index, "raw")
        if layer is not None:
            _, order = self.writer.add_layer(index, group.first_frame, layer)
            self._order = np.concatenate([self._order, len(self._order) + order])
        # The alive bits count in the order that training saw; another encoder may have put the points into another order.
        alive = group.alive[self._order]
        self.writer.add_group(Group(index, group.first_frame, group.dynamic, group.dx, group.dq, alive))

    def skip(self, index: int) -> None:
        """A group that the reel holds already, in the order of its checkpoint."""
        born = load_layer(self.work, index, "raw")
        self._order = np.concatenate([self._order, len(self._order) + np.arange(0 if born is None else len(born))])


def encode(work: Path, reel: Path, config: EncodeConfig, progress: Progress) -> Path:
    """Write a reel from the checkpoints of a reconstruction, without training; returns the reel's folder."""
    count = finished_groups(work)
    if count == 0:
        raise ReconstructionError(f"{work}: holds no finished group. Run splatreel reconstruct first.")
    writer = open_writer(work, reel, config, resume=False)
    publisher = Publisher(writer, work)
    progress.stage("encode", count)
    for index in range(count):
        publisher.publish(index)
        progress.update(index + 1)
    writer.finish()
    return reel


class UndecodedReel:
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
