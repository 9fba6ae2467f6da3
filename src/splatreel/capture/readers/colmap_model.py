"""COLMAP models: their places in a folder, their images, and cameras that have an image per frame."""

from __future__ import annotations

import errno
import importlib.util
import os
import re
import shutil
import signal
import struct
import tempfile
import threading
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any

import numpy as np

from splatreel.base.command_line import install_command
from splatreel.base.errors import CaptureError, MissingDependencyError
from splatreel.base.process import signals_held
from splatreel.base.untrusted import check_regular, open_regular
from splatreel.capture.files import list_folder, natural_key

PLACES = ("sparse", "sparse_", "colmap/sparse", ".")
"""Folders that hold a model, or numbered folders with a model each. 4DGaussians uses `sparse_`."""
SUFFIXES = (".bin", ".txt")
NUMBER = re.compile("([0-9]+)")
STILL_SHARE, STILL_DEGREES = 0.05, 2.0
"""Maximum distance between the poses of one static camera at different frames: share of the size of the rig, and angle."""
NO_PYCOLMAP = f"""COLMAP models, lenses with distortion and `capture calibrate` need pycolmap, which is not installed. Run
  {install_command("recon")}
For Linux on ARM, Intel Macs, macOS before 14 and Windows on ARM there is no pycolmap to install (docs/install.md). Read this capture
on another system."""
FRAME = "#"
"""Character that stands for the number of the frame in a name. COLMAP's names are paths, in which it is rare."""


@dataclass(frozen=True)
class ModelCamera:
    """Static camera of a model."""

    name: str
    image: Any
    pattern: str | None = None


@dataclass(frozen=True)
class Model:
    """Model of a folder.

    Attributes:
        folder: Folder of its files.
        reconstruction: The pycolmap.Reconstruction.
        cameras: Static cameras in the order of their names.
        notes: Sentences about what was chosen.
    """

    folder: Path
    reconstruction: Any
    cameras: list[ModelCamera]
    notes: list[str]


def model_folders(path: Path) -> list[Path]:
    """Return all folders of a capture that hold a COLMAP model."""
    places = [path / place for place in PLACES]
    folders = [folder for place in places[:-1] for folder in [*list_folder(place), place]] + places[-1:]
    return [folder for folder in folders if _suffix(folder) is not None]


def read_model(path: Path) -> Model:
    """Return the model of a folder with the most images.

    Raises:
        CaptureError: There is no model, or the chosen one cannot be read or has no images.
    """
    folders = model_folders(path)
    if not folders:
        raise CaptureError(
            f"{path}: holds no COLMAP model (cameras.bin or cameras.txt in sparse/0, sparse or the folder)."
        )
    counts = {folder: _count_images(folder) for folder in folders}
    chosen = max(folders, key=lambda folder: counts[folder])  # the first of equal ones
    notes = []
    if len(folders) > 1:
        others = ", ".join(f"{f.relative_to(path)} has {counts[f]}" for f in folders if f != chosen)
        notes.append(
            f"the COLMAP model {chosen.relative_to(path)} is read, since it has the most images, {counts[chosen]}; {others}"
        )
    reconstruction = _read(chosen)
    if not reconstruction.images:
        raise CaptureError(f"{chosen}: the COLMAP model holds no images with a pose.")
    images = sorted(reconstruction.images.values(), key=lambda image: natural_key(stem(image)))
    cameras = _static_cameras(images)
    if cameras is None:
        cameras = [ModelCamera(stem(image), image) for image in images]
    else:
        notes.append(f"the model has {len(images)} images of {len(cameras)} static cameras, one for each frame")
    return Model(chosen, reconstruction, cameras, notes)


def stem(image: Any) -> str:
    """Return the name of an image without extension."""
    return PurePosixPath(image.name).with_suffix("").as_posix()


def import_pycolmap() -> ModuleType:
    """Return the module pycolmap. Raise `MissingDependencyError` if it is not installed.

    PyAV must be loaded before pycolmap, otherwise either may crash. The import installs a handler of SIGTERM that prints
    a stack trace and can hang. The signal is held until the previous handler is back.
    """
    with signals_held(signal.SIGTERM):
        ended_by = signal.getsignal(signal.SIGTERM)
        try:
            import pycolmap
        except ImportError as error:
            raise MissingDependencyError(NO_PYCOLMAP) from error
        finally:
            if ended_by is not None and threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGTERM, ended_by)
    return pycolmap


def write_model(model: Any, folder: Path) -> None:
    """Write a pycolmap.Reconstruction into a new folder, and check the sizes of its files: COLMAP says nothing of a full disk.

    Raises:
        OSError: The folder cannot be written, or the disk is full.
    """
    folder.mkdir()
    model.write_binary(str(folder))
    images, points = model.images.values(), model.points3D.values()
    sizes = {
        "cameras.bin": 8 + sum(24 + 8 * len(camera.params) for camera in model.cameras.values()),
        "images.bin": 8 + sum(73 + len(image.name.encode()) + 24 * len(image.points2D) for image in images),
        "points3D.bin": 8 + sum(51 + 8 * point.track.length() for point in points),
    }
    if any(not (folder / name).is_file() or (folder / name).stat().st_size < size for name, size in sizes.items()):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))


def require_pycolmap() -> None:
    """Raise `MissingDependencyError` if pycolmap is not installed. This does not import it, as `import_pycolmap` does."""
    if importlib.util.find_spec("pycolmap") is None:
        raise MissingDependencyError(NO_PYCOLMAP)


def _suffix(folder: Path) -> str | None:
    """Return the extension of a model's files, or None without a model."""
    return next((suffix for suffix in SUFFIXES if (folder / f"cameras{suffix}").is_file()), None)


def _count_images(folder: Path) -> int:
    """Return the number of images of a model without reading it; 0 if that is not possible."""
    suffix = _suffix(folder)
    try:
        with open_regular(folder / f"images{suffix}", CaptureError) as file:
            if suffix == ".bin":
                return struct.unpack("<Q", file.read(8))[0]
            lines = [line for line in file.read().splitlines() if not line.startswith(b"#")]
            return (len(lines) + 1) // 2
    except (OSError, struct.error, CaptureError):
        return 0


def _read(folder: Path) -> Any:
    """Return a pycolmap.Reconstruction. A model without a file of points has none."""
    pycolmap, suffix = import_pycolmap(), _suffix(folder)
    for file in folder.glob(f"*{suffix}"):
        check_regular(file, CaptureError)
    try:
        if any((folder / f"points3D{found}").exists() for found in SUFFIXES):
            return pycolmap.Reconstruction(str(folder))
        with tempfile.TemporaryDirectory(prefix="splatreel-model") as copy:
            for file in folder.glob(f"*{suffix}"):
                _link_or_copy(file.resolve(), Path(copy) / file.name)
            (Path(copy) / f"points3D{suffix}").write_bytes(bytes(8) if suffix == ".bin" else b"")
            return pycolmap.Reconstruction(copy)
    except Exception as error:  # pycolmap passes on all exceptions of its C++ reader
        raise CaptureError(f"{folder}: cannot be read as a COLMAP model ({error}). Export it again.") from error


def _link_or_copy(file: Path, place: Path) -> None:
    """Link to a file, or copy it where links are not allowed, as for users of Windows without developer mode."""
    try:
        place.symlink_to(file)
    except OSError:
        shutil.copyfile(file, place)


def _static_cameras(images: list[Any]) -> list[ModelCamera] | None:
    """Return the cameras of a model that has an image per frame of static cameras; None for another model.

    Images that differ only by one number in their names are frames of a camera if they have the same pose.
    """
    poses = {image.image_id: np.asarray(image.cam_from_world().matrix()) for image in images}
    for back in range(1, 1 + max(len(NUMBER.findall(stem(image))) for image in images)):
        groups: dict[str, list[Any]] = defaultdict(list)
        for image in images:
            groups[_mask_number(stem(image), back)].append(image)
        if 1 < len(groups) < len(images) and _stand_still(groups, poses):
            found = [ModelCamera(_camera_name(name), _middle(group, poses), name) for name, group in groups.items()]
            if len({camera.name for camera in found}) == len(found):
                return found
    return None


def _mask_number(name: str, back: int) -> str:
    """Replace the number that is `back` from the end by `#`."""
    parts = NUMBER.split(name)
    if 2 * back <= len(parts):
        parts[-2 * back] = FRAME
    return "".join(parts)


def _camera_name(pattern: str) -> str:
    """Return `cam00` for `cam00/frame_#`, `#/cam00` and `cam00_#`."""
    parts = [part for part in pattern.split("/") if FRAME not in part]
    return "/".join(parts) or pattern.replace(FRAME, "").strip("_-. ") or pattern


def _stand_still(groups: dict[str, list[Any]], poses: dict[int, np.ndarray]) -> bool:
    """Return whether the images of each group have the same pose."""
    middles = [_center(poses[_middle(group, poses).image_id]) for group in groups.values()]
    size = float(np.linalg.norm(np.ptp(middles, axis=0)))
    for group in groups.values():
        base = poses[_middle(group, poses).image_id]
        for image in group:
            pose = poses[image.image_id]
            cosine = (np.trace(pose[:, :3] @ base[:, :3].T) - 1) / 2
            turned = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
            if turned > STILL_DEGREES or np.linalg.norm(_center(pose) - _center(base)) > STILL_SHARE * size:
                return False
    return True


def _middle(images: list[Any], poses: dict[int, np.ndarray]) -> Any:
    """Return the image whose center is nearest to the median of all."""
    centers = np.stack([_center(poses[image.image_id]) for image in images])
    return images[int(np.linalg.norm(centers - np.median(centers, 0), axis=1).argmin())]


def _center(pose: np.ndarray) -> np.ndarray:
    return -pose[:, :3].T @ pose[:, 3]
