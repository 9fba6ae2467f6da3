"""COLMAP models: one time step of undistorted photographs, with their cameras and sparse points.

The photographs lie in `images`, or smaller in `images_2`, `images_4`, ...; their names may differ from the model's in the extension.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from splatreel.capture.base import Capture, Request
from splatreel.capture.images import image_size, read_image
from splatreel.errors import CaptureError, MissingDependencyError
from splatreel.scene.camera import Camera

MODELS = ("sparse/0", "sparse", "colmap/sparse/0", ".")
SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")
FOCAL_LENGTHS = {"SIMPLE_PINHOLE": 1, "PINHOLE": 2, "SIMPLE_RADIAL": 1, "RADIAL": 1, "OPENCV": 2}
"""Camera models that are pinholes if their distortion is zero, and how many of their parameters are focal lengths."""


def is_colmap(path: Path) -> bool:
    return _model_folder(path) is not None


class ColmapCapture(Capture):
    """A COLMAP model with its images; the first image by name is held out unless the request says otherwise.

    A camera is named by its image without the extension. `scale` counts from the size that the model is for, whichever folder of
    images is there; the smallest images that are large enough are read. Without a size they are read as they are.
    """

    def __init__(self, path: Path, request: Request) -> None:
        model = _model_folder(path)
        if model is None:
            raise CaptureError(f"{path}: holds no COLMAP model (cameras.bin or cameras.txt in {', '.join(MODELS)}).")
        reconstruction = _read_model(model)
        cameras = sorted((_camera(model, i) for i in reconstruction.images.values()), key=lambda c: c.name)
        folders = _image_folders(path, cameras)
        first = cameras[0]
        if request.width is None and request.scale is None:
            width, height = max(folders)
        else:
            width, height = request.size(first.width, first.height, path)
        large_enough = [size for size in folders if size[0] >= width]
        self._files = folders[min(large_enough) if large_enough else max(folders)]
        points, colors = _points(reconstruction)
        super().__init__(
            path,
            [_resized(model, c, first, width, height) for c in cameras],
            held_out=[first.name] if request.held_out is None else request.held_out,
            frame_range=request.range(1, path),
            points=points,
            point_colors=colors,
        )

    def sources(self) -> list[Path]:
        return [self._files[camera.name] for camera in self.cameras]

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        for c, name in enumerate(cameras):
            out[0, c] = read_image(self._files[name], self.width, self.height)


def _model_folder(path: Path) -> Path | None:
    for name in MODELS:
        if any((path / name / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return path / name
    return None


def _pycolmap() -> ModuleType:
    try:
        import pycolmap
    except ImportError as error:
        raise MissingDependencyError("Reading COLMAP models needs pycolmap: pip install 'splatreel[recon]'.") from error
    return pycolmap


def _read_model(model: Path) -> Any:
    """The model as a pycolmap.Reconstruction with at least one image."""
    pycolmap = _pycolmap()
    try:
        reconstruction = pycolmap.Reconstruction(str(model))
    except Exception as error:  # pycolmap passes on whatever its C++ reader throws
        raise CaptureError(f"{model}: cannot be read as a COLMAP model ({error}). Export it again.") from error
    if not reconstruction.images:
        raise CaptureError(f"{model}: the COLMAP model holds no images with a pose.")
    return reconstruction


def _camera(model: Path, image: Any) -> Camera:
    """One image of the model as a camera of the model's size."""
    camera = image.camera
    kind, params = camera.model.name, np.asarray(camera.params, np.float64)
    if kind not in FOCAL_LENGTHS or np.abs(params[FOCAL_LENGTHS[kind] + 2 :]).max(initial=0) > 1e-9:
        raise CaptureError(
            f"{model}: camera {camera.camera_id} is {kind} with parameters {params.tolist()}; only undistorted pinhole cameras "
            f"work. Run `colmap image_undistorter` on the model first."
        )
    viewmat = np.eye(4)
    pose = image.cam_from_world  # a property up to pycolmap 3.11, a method since
    viewmat[:3] = (pose if hasattr(pose, "matrix") else pose()).matrix()
    name = Path(image.name).with_suffix("").as_posix()
    return Camera(name, viewmat, np.asarray(camera.calibration_matrix()), camera.width, camera.height)


def _resized(model: Path, camera: Camera, first: Camera, width: int, height: int) -> Camera:
    if abs(camera.width / camera.height * first.height / first.width - 1) > 0.01:
        raise CaptureError(
            f"{model}: {first.name} is {first.width}x{first.height} but {camera.name} is {camera.width}x{camera.height}; "
            f"all images must have the same aspect ratio."
        )
    return camera.resized(width, height)


def _image_folders(path: Path, cameras: list[Camera]) -> dict[tuple[int, int], dict[str, Path]]:
    """By the size of its images, each folder that has the image of every camera, as {camera: file}."""
    folders, missing = {}, []
    for folder in sorted(path.glob("images*")):
        files = {
            f.relative_to(folder).with_suffix("").as_posix(): f
            for f in folder.rglob("*")
            if f.suffix.lower() in SUFFIXES
        }
        absent = [c.name for c in cameras if c.name not in files]
        if absent:
            missing.append(f"{folder.name} lacks {len(absent)} of {len(cameras)}, the first is {absent[0]}")
        else:
            folders[image_size(files[cameras[0].name])] = files
    if not folders:
        raise CaptureError(
            f"{path}: no folder images, images_2, ... holds the images of all {len(cameras)} cameras of the model"
            f"{': ' + '; '.join(missing) if missing else ''}. Copy them there; the extension may differ."
        )
    return folders


def _points(reconstruction: Any) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Sparse points [P, 3] float32 and their colours 0..1, in the order of their ids; None where there are none."""
    points = [p for _, p in sorted(reconstruction.points3D.items())]
    if not points:
        return None, None
    return np.array([p.xyz for p in points], np.float32), np.array([p.color for p in points], np.float32) / 255
