"""COLMAP models: cameras with lenses and sparse points, and a video or images per camera.

Videos are in the folder itself or in `videos`. Images are in `images`, or smaller in `images_2`, `images_4`, ...: one
photograph per camera, which is one time step, or one folder of images per camera. File extensions may differ from the
model's. Images with distortion, or with another aspect ratio than the other cameras', are resampled for a pinhole
camera.
"""

from __future__ import annotations

import signal
import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any

import numpy as np

from splatreel.capture.base import Request
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.files import Files
from splatreel.capture.growing.segmented_video import segment_files
from splatreel.capture.image_sequences import IMAGE_SUFFIXES, image_files
from splatreel.capture.images import image_size
from splatreel.capture.lens import Lens, undistorted_camera
from splatreel.capture.sidecar import read_sidecar
from splatreel.capture.sources import picture_source, video_source
from splatreel.capture.video import VIDEO_SUFFIXES
from splatreel.errors import CaptureError, MissingDependencyError
from splatreel.scene.camera import Camera, middle_camera

MODELS = ("sparse/0", "sparse", "colmap/sparse/0", ".")
VIDEOS = ("videos", ".")


def is_colmap(path: Path) -> bool:
    """Return whether a folder holds a COLMAP model."""
    return _model_folder(path) is not None


class ColmapCapture(FileCapture):
    """COLMAP model with videos or images. By default a middle camera is held out.

    A camera is named by its image without extension, or by its folder if the folder has more images of the camera.
    `scale` refers to the size of most of the model's images. The smallest images that are large enough are read.
    """

    def __init__(self, path: Path, request: Request) -> None:
        model = _model_folder(path)
        if model is None:
            raise CaptureError(f"{path}: holds no COLMAP model (cameras.bin or cameras.txt in {', '.join(MODELS)}).")
        reconstruction = _read_model(model)
        images = sorted(reconstruction.images.values(), key=_name)
        shape = Counter((image.camera.width, image.camera.height) for image in images).most_common(1)[0][0]
        growing, sidecar = request.growth is not None, read_sidecar(path)
        files, names = video_files(path, segmented=True), _camera_names(path, images, 0 if growing else 1)
        if any(name in files for name in names):
            # Start times of videos that calibration left out are ignored.
            starts = {name: start for name, start in sidecar.starts.items() if name in names or name not in files}
            source = video_source(path, _of_cameras(path, files, names), replace(sidecar, starts=starts), request)
            width, height = request.size(*shape, path)
        else:
            pictures, (width, height) = _choose(path, names, shape, request)
            source = picture_source(path, pictures, sidecar, request)
        first, _ = request.range(source.frames, path)
        points, colors = (
            _points(reconstruction) if first == 0 else (None, None)
        )  # the model was made from the first frame
        lenses: dict[str, Lens] = {}
        cameras = [
            _camera(model, name, image, width, height, lenses) for name, image in zip(names, images, strict=True)
        ]
        middle = names[middle_camera(cameras)]
        super().__init__(
            path,
            cameras,
            source,
            request,
            held_out=[middle] if sidecar.held_out is None else sidecar.held_out,
            lenses=lenses,
            points=points,
            point_colors=colors,
            origin=model,
        )


def _camera(model: Path, name: str, image: Any, width: int, height: int, lenses: dict[str, Lens]) -> Camera:
    """Return an image of the model as a camera at the output size, and record its lens if it has distortion."""
    viewmat = np.eye(4)
    viewmat[:3] = image.cam_from_world().matrix()
    origin = f"{model}: camera {image.camera.camera_id}"
    camera, lens = undistorted_camera(name, viewmat, image.camera, width, height, origin)
    if lens is not None:
        lenses[name] = lens
    return camera


def _choose(
    path: Path, names: list[str], shape: tuple[int, int], request: Request
) -> tuple[dict[str, list[Path]], tuple[int, int]]:
    """Return the images to read by camera, and the output size."""
    folders = _image_folders(path, names, request.files)
    width, height = max(folders)
    if request.width is not None or request.scale is not None:
        width, height = request.size(*shape, path)
    large_enough = [size for size in folders if size[0] >= width]
    return folders[min(large_enough) if large_enough else max(folders)], (width, height)


def video_files(path: Path, segmented: bool = False) -> dict[str, Path]:
    """Return the videos of a folder by name: those in its folder `videos`, otherwise its own.

    Args:
        path: Folder of the capture.
        segmented: Also return folders of numbered videos.
    """
    for folder in VIDEOS:
        found = sorted((path / folder).glob("*"))
        files = {f.stem: f for f in found if f.suffix.lower() in VIDEO_SUFFIXES}
        if segmented:
            files |= {f.name: f for f in found if f.is_dir() and segment_files(f)}
        if files:
            return files
    return {}


def _model_folder(path: Path) -> Path | None:
    for name in MODELS:
        if any((path / name / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return path / name
    return None


def import_pycolmap() -> ModuleType:
    """Return the module pycolmap. Raise `MissingDependencyError` if it is not installed.

    PyAV must be loaded before pycolmap, otherwise either may crash.
    """
    ended_by = signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap
    except ImportError as error:
        raise MissingDependencyError("Reading COLMAP models needs pycolmap: pip install 'splatreel[recon]'.") from error
    if ended_by is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, ended_by)  # pycolmap's logging treats the signal as a crash and aborts
    return pycolmap


def _read_model(model: Path) -> Any:
    """Return the model as a pycolmap.Reconstruction with at least one image."""
    pycolmap = import_pycolmap()
    try:
        reconstruction = pycolmap.Reconstruction(str(model))
    except Exception as error:  # pycolmap passes on all exceptions of its C++ reader
        raise CaptureError(f"{model}: cannot be read as a COLMAP model ({error}). Export it again.") from error
    if not reconstruction.images:
        raise CaptureError(f"{model}: the COLMAP model holds no images with a pose.")
    return reconstruction


def _name(image: Any) -> str:
    return Path(image.name).with_suffix("").as_posix()


def _camera_names(path: Path, images: list[Any], single: int) -> list[str]:
    """Return names by image, or by folder if each folder holds more than `single` images of one camera."""
    names = [_name(image) for image in images]
    parents = [str(PurePosixPath(name).parent) for name in names]
    own = len(set(parents)) == len(parents) and "." not in parents
    if own and any(len(image_files(folder / parents[0])) > single for folder in path.glob("images*")):
        return parents
    return names


def _of_cameras(path: Path, files: dict[str, Path], names: list[str]) -> dict[str, Path]:
    """Return the video of every camera of the model."""
    absent = [name for name in names if name not in files]
    if absent:
        raise CaptureError(
            f"{path}: the model has {len(names)} cameras, and {len(absent)} of them no video, the first is {absent[0]}; there are "
            f"{', '.join(files)}. Name each video as its image in the model."
        )
    return {name: files[name] for name in names}


def _image_folders(path: Path, names: list[str], where: Files) -> dict[tuple[int, int], dict[str, list[Path]]]:
    """Return folders with images of every camera by image size, as {camera: files}."""
    folders, missing = {}, []
    for folder in sorted(path.glob("images*")):
        files = pictures_by_camera(folder, names)
        absent = [name for name in names if name not in files]
        if absent:
            missing.append(f"{folder.name} lacks {len(absent)} of {len(names)}, the first is {absent[0]}")
        else:
            folders[image_size(files[names[0]][0], where)] = files
    if not folders:
        raise CaptureError(
            f"{path}: no folder images, images_2, ... holds the images of all {len(names)} cameras of the model"
            f"{': ' + '; '.join(missing) if missing else ''}. Copy them there, or a "
            f"video of each camera, named as its image, beside the model; extensions may differ."
        )
    return folders


def pictures_by_camera(folder: Path, names: list[str]) -> dict[str, list[Path]]:
    """Return the images of each camera that a folder has: the image with its name, or those in the folder with its name."""
    single = {
        file.relative_to(folder).with_suffix("").as_posix(): [file]
        for file in folder.rglob("*")
        if file.suffix.lower() in IMAGE_SUFFIXES
    }
    several = {name: image_files(folder / name) for name in names}
    return {name: files for name in names if (files := single.get(name) or several[name])}


def _points(reconstruction: Any) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return sparse points [P, 3] float32 and colors 0..1 in order of their ids, or None."""
    points = [p for _, p in sorted(reconstruction.points3D.items())]
    if not points:
        return None, None
    return np.array([p.xyz for p in points], np.float32), np.array([p.color for p in points], np.float32) / 255
