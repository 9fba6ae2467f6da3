"""COLMAP models: cameras with their lenses and sparse points, and a video of each, or a photograph: one time step.

The videos lie in the folder itself or in `videos`; the photographs in `images`, or smaller in `images_2`, `images_4`, ... Their
names may differ from the model's in the extension. Pictures of lenses that bend, or of another shape than the other cameras', are
made those of pinhole cameras.
"""

from __future__ import annotations

import signal
import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from splatreel.capture.base import Capture, Request, read_cameras
from splatreel.capture.images import image_size, read_image
from splatreel.capture.lens import Lens, pinhole
from splatreel.capture.sidecar import read_sidecar
from splatreel.capture.videos import Videos
from splatreel.errors import CaptureError, MissingDependencyError
from splatreel.scene.camera import Camera

MODELS = ("sparse/0", "sparse", "colmap/sparse/0", ".")
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")
VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mts")
VIDEOS = ("videos", ".")
FOCAL_LENGTHS = {"SIMPLE_PINHOLE": 1, "PINHOLE": 2, "SIMPLE_RADIAL": 1, "RADIAL": 1, "OPENCV": 2}
"""Camera models that are pinholes if their distortion is zero, and how many of their parameters are focal lengths."""
SAME_SHAPE = 0.01
"""Share by which widths over heights may differ without a picture being cut."""


def is_colmap(path: Path) -> bool:
    return _model_folder(path) is not None


class ColmapCapture(Capture):
    """A COLMAP model with its videos or images; the first camera by name is held out unless the request or its note says otherwise.

    A camera is named by its image without the extension. `scale` counts from the size that most of the model's images have, whichever
    folder of images is there; the smallest images that are large enough are read. Without a size they are read as they are.
    """

    def __init__(self, path: Path, request: Request) -> None:
        model = _model_folder(path)
        if model is None:
            raise CaptureError(f"{path}: holds no COLMAP model (cameras.bin or cameras.txt in {', '.join(MODELS)}).")
        reconstruction = _read_model(model)
        images = sorted(reconstruction.images.values(), key=_name)
        names, lenses = [_name(image) for image in images], [image.camera for image in images]
        shape = Counter((lens.width, lens.height) for lens in lenses).most_common(1)[0][0]
        files, sidecar = video_files(path), read_sidecar(path)
        self._videos: Videos | None = None
        if any(name in files for name in names):
            # Videos that calibration left out start as well.
            starts = {name: start for name, start in sidecar.starts.items() if name in names or name not in files}
            self._videos = Videos(path, _of_cameras(path, files, names), replace(sidecar, starts=starts), request)
            width, height = request.size(*shape, path)
        else:
            width, height = self._choose_images(path, names, shape, request)
        self._lenses: dict[str, Lens] = {}
        span = request.range(self._videos.frames if self._videos else 1, path)
        points, colors = _points(reconstruction) if span[0] == 0 else (None, None)  # of what the model was made from
        held_out = names[:1] if sidecar.held_out is None else sidecar.held_out
        super().__init__(
            path,
            [self._camera(model, image, width, height) for image in images],
            held_out=held_out if request.held_out is None else request.held_out,
            frame_range=span,
            fps=self._videos.fps if self._videos else 30.0,
            points=points,
            point_colors=colors,
        )

    def _choose_images(self, path: Path, names: list[str], shape: tuple[int, int], request: Request) -> tuple[int, int]:
        """The folder that is read, and the size of what comes out."""
        folders = _image_folders(path, names)
        width, height = max(folders)
        if request.width is not None or request.scale is not None:
            width, height = request.size(*shape, path)
        large_enough = [size for size in folders if size[0] >= width]
        self._images = folders[min(large_enough) if large_enough else max(folders)]
        return width, height

    def _camera(self, model: Path, image: Any, width: int, height: int) -> Camera:
        """One image of the model as a camera of the output size, and, where it takes more than resizing, its lens."""
        name, lens, viewmat = _name(image), image.camera, np.eye(4)
        viewmat[:3] = image.cam_from_world().matrix()
        if _is_pinhole(lens) and abs(lens.width / lens.height * height / width - 1) <= SAME_SHAPE:
            K = np.asarray(lens.calibration_matrix())
            return Camera(name, viewmat, K, lens.width, lens.height).resized(width, height)
        found = pinhole(name, viewmat, lens, width, height)
        if found is None:
            raise CaptureError(
                f"{model}: camera {lens.camera_id} is {lens.model.name} with parameters {np.asarray(lens.params).tolist()}, which "
                f"is no lens that could be straightened. Calibrate it again."
            )
        self._lenses[name] = found[1]
        return found[0]

    def sources(self) -> list[Path]:
        return self._videos.sources() if self._videos else [self._images[camera.name] for camera in self.cameras]

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        read_cameras(self._read_camera, out, first, cameras)

    def _read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        lens = self._lenses.get(name)
        if lens is None:
            self._read_raw(out, first, name)
            return
        bent = np.empty((len(out), lens.height, lens.width, 3), np.uint8)
        self._read_raw(bent, first, name)
        for t, picture in enumerate(bent):
            out[t] = lens.straighten(picture)

    def _read_raw(self, out: np.ndarray, first: int, name: str) -> None:
        """As the files have it, but for the size."""
        if self._videos:
            self._videos.read_camera(out, first, name)
        else:
            out[0] = read_image(self._images[name], out.shape[2], out.shape[1])

    def close(self) -> None:
        if self._videos:
            self._videos.close()


def video_files(path: Path) -> dict[str, Path]:
    """The videos of a folder by name, those in its folder `videos` or else its own."""
    for folder in VIDEOS:
        files = {f.stem: f for f in sorted((path / folder).glob("*")) if f.suffix.lower() in VIDEO_SUFFIXES}
        if files:
            return files
    return {}


def _model_folder(path: Path) -> Path | None:
    for name in MODELS:
        if any((path / name / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return path / name
    return None


def import_pycolmap() -> ModuleType:
    """Raises `MissingDependencyError` where it is not installed. PyAV is loaded already: after pycolmap, either may crash."""
    ended_by = signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap
    except ImportError as error:
        raise MissingDependencyError("Reading COLMAP models needs pycolmap: pip install 'splatreel[recon]'.") from error
    if ended_by is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, ended_by)  # its log takes the signal for a crash: it dumps the stack and aborts
    return pycolmap


def _read_model(model: Path) -> Any:
    """The model as a pycolmap.Reconstruction with at least one image."""
    pycolmap = import_pycolmap()
    try:
        reconstruction = pycolmap.Reconstruction(str(model))
    except Exception as error:  # pycolmap passes on whatever its C++ reader throws
        raise CaptureError(f"{model}: cannot be read as a COLMAP model ({error}). Export it again.") from error
    if not reconstruction.images:
        raise CaptureError(f"{model}: the COLMAP model holds no images with a pose.")
    return reconstruction


def _name(image: Any) -> str:
    return Path(image.name).with_suffix("").as_posix()


def _is_pinhole(lens: Any) -> bool:
    focal_lengths = FOCAL_LENGTHS.get(lens.model.name)
    return focal_lengths is not None and np.abs(lens.params[focal_lengths + 2 :]).max(initial=0) <= 1e-9


def _of_cameras(path: Path, files: dict[str, Path], names: list[str]) -> dict[str, Path]:
    """The video of every camera of the model."""
    absent = [name for name in names if name not in files]
    if absent:
        raise CaptureError(
            f"{path}: the model has {len(names)} cameras, and {len(absent)} of them no video, the first is {absent[0]}; there are "
            f"{', '.join(files)}. Name each video as its image in the model."
        )
    return {name: files[name] for name in names}


def _image_folders(path: Path, names: list[str]) -> dict[tuple[int, int], dict[str, Path]]:
    """By the size of its images, each folder that has the image of every camera, as {camera: file}."""
    folders, missing = {}, []
    for folder in sorted(path.glob("images*")):
        files = {
            f.relative_to(folder).with_suffix("").as_posix(): f
            for f in folder.rglob("*")
            if f.suffix.lower() in IMAGE_SUFFIXES
        }
        absent = [name for name in names if name not in files]
        if absent:
            missing.append(f"{folder.name} lacks {len(absent)} of {len(names)}, the first is {absent[0]}")
        else:
            folders[image_size(files[names[0]])] = files
    if not folders:
        raise CaptureError(
            f"{path}: no folder images, images_2, ... holds the images of all {len(names)} cameras of the model"
            f"{': ' + '; '.join(missing) if missing else ''}. Copy them there, or a "
            f"video of each camera, named as its image, beside the model; extensions may differ."
        )
    return folders


def _points(reconstruction: Any) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Sparse points [P, 3] float32 and their colours 0..1, in the order of their ids; None where there are none."""
    points = [p for _, p in sorted(reconstruction.points3D.items())]
    if not points:
        return None, None
    return np.array([p.xyz for p in points], np.float32), np.array([p.color for p in points], np.float32) / 255
