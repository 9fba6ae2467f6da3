"""COLMAP models: cameras with lenses and sparse points, and a video or images per camera.

Videos are in the folder itself or in `videos`. Images are in `images`, or smaller in `images_2`, `images_4`, ...: one
photograph per camera, which is one time step, or one folder of images per camera. File extensions may differ from the
model's. EXIF's orientation is ignored, as by COLMAP. Images with distortion, or with another aspect ratio than the
most cameras', are resampled for a pinhole camera. A model may also have an image for each frame of static cameras.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from splatreel.base.command_line import option, quoted
from splatreel.base.errors import CaptureError
from splatreel.base.progress import listed
from splatreel.capture.base import Request
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.files import Files, list_folder
from splatreel.capture.image_sequences import IMAGE_SUFFIXES, flat_images, image_files, image_source
from splatreel.capture.images import image_size
from splatreel.capture.lens import Lens, common_size, undistorted_camera
from splatreel.capture.readers.colmap_model import FRAME, Model, ModelCamera, model_folders, read_model
from splatreel.capture.segmented_video import segment_files
from splatreel.capture.sidecar import read_sidecar
from splatreel.capture.video import OTHER_VIDEOS, VIDEO_SUFFIXES
from splatreel.capture.videos import video_source
from splatreel.scene.camera import Camera, middle_camera

VIDEOS = ("videos", "synchronized_videos", ".")
PAPER_HELD_OUT = "cam07"
"""Camera that the paper holds out of its own captures (DeskGames)."""


def is_colmap(path: Path) -> bool:
    """Return whether a folder holds a COLMAP model."""
    return bool(model_folders(path))


class ColmapCapture(FileCapture):
    """COLMAP model with videos or images. By default a middle camera is held out, or cam07 of the paper's captures.

    A camera is named by its image without extension, or by its folder if the folder has more images of the camera.
    `scale` refers to the size of most of the model's images. The smallest images that are large enough are read.
    """

    def __init__(self, path: Path, request: Request) -> None:
        model = read_model(path)
        notes = list(model.notes)
        growing, sidecar = request.growth is not None, read_sidecar(path)
        files, found = video_files(path, segmented=True), camera_folders(path)
        everything = _named_by_folder(path, model.cameras, 0 if growing else 1)
        everything = _renamed(model, everything, files or found, notes)
        cameras = [camera for camera in everything if camera.name not in request.left_out]
        names = [camera.name for camera in cameras]
        shape = common_size([_size(camera) for camera in cameras])
        if any(name in files for name in names):
            # Start times of videos that calibration left out are ignored.
            sidecar = sidecar.only({*names, *sidecar.starts, *sidecar.rates} - (set(files) - set(names)))
            notes += _unused(files, [*names, *request.left_out])
            source = video_source(path, _of_cameras(path, files, names), sidecar, request)
            width, height = request.size(*shape, path)
        else:
            images, (width, height) = _choose(path, cameras, found, shape, request)
            source = image_source(path, images, sidecar, request, upright=False)
        first, _ = request.range(source.frames, path)
        # The model was made from the first frame.
        points, colors = _points(model.reconstruction) if first == 0 else (None, None)
        lenses: dict[str, Lens] = {}
        views = [_camera(model.folder, camera, width, height, lenses) for camera in everything]
        default = names[middle_camera(request.kept(views, path))]
        if PAPER_HELD_OUT in names and _is_of_paper(path, model):
            default = PAPER_HELD_OUT
        super().__init__(
            path,
            views,
            source,
            request,
            held_out=[default] if sidecar.held_out is None else sidecar.held_out,
            lenses=lenses,
            points=points,
            point_colors=colors,
            origin=model.folder,
            notes=notes,
            calibrated={view.name: _size(view) for view in everything},
        )


def _is_of_paper(path: Path, model: Model) -> bool:
    """Return whether a capture is laid out as the paper's: `videos/cam00.mp4`, and a model in `colmap` of `0.png`, `1.png`, ..."""
    in_colmap = model.folder.is_relative_to(path / "colmap")
    return in_colmap and bool(video_files(path / "videos")) and all(camera.name.isdecimal() for camera in model.cameras)


def is_model_alone(path: Path) -> bool:
    """Return whether a folder holds a COLMAP model without videos or images."""
    if not is_colmap(path) or video_files(path, segmented=True) or camera_folders(path):
        return False
    return not any(folder.name.startswith("images") and folder.is_dir() for folder in list_folder(path))


def model_views(path: Path) -> list[Camera]:
    """Return the cameras of a folder's COLMAP model without their images, at the size of the model, as pinhole cameras."""
    model = read_model(path)
    lenses: dict[str, Lens] = {}
    return [
        _camera(model.folder, camera, camera.image.camera.width, camera.image.camera.height, lenses)
        for camera in model.cameras
    ]


def _camera(model: Path, view: ModelCamera, width: int, height: int, lenses: dict[str, Lens]) -> Camera:
    viewmat = np.eye(4)
    viewmat[:3] = view.image.cam_from_world().matrix()
    origin = f"{model}: camera {view.image.camera.camera_id}"
    camera, lens = undistorted_camera(view.name, viewmat, view.image.camera, width, height, origin)
    if lens is not None:
        lenses[view.name] = lens
    return camera


def _size(view: ModelCamera) -> tuple[int, int]:
    return view.image.camera.width, view.image.camera.height


def _choose(
    path: Path,
    cameras: list[ModelCamera],
    found: dict[str, list[Path]],
    shape: tuple[int, int],
    request: Request,
) -> tuple[dict[str, list[Path]], tuple[int, int]]:
    """Return the images to read by camera, and the output size."""
    usual = next(camera.name for camera in cameras if _size(camera) == shape)
    folders = _image_folders(path, cameras, found, usual, request.files)
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

    Raises:
        CaptureError: Two videos have the same name.
    """
    return next((files for folder in VIDEOS if (files := videos_in(path / folder, segmented))), {})


def videos_but(path: Path, left_out: Sequence[str]) -> dict[str, Path]:
    """Return the videos of a folder by name, also those in several files, without some. Raise `CaptureError` for an unknown name."""
    files = video_files(path, segmented=True)
    if unknown := [name for name in left_out if name not in files]:
        raise CaptureError(
            f"{path}: there is no video {unknown[0]!r} to leave out; there are {', '.join(files) or 'none'}."
        )
    return {name: file for name, file in files.items() if name not in left_out}


def videos_in(folder: Path, segmented: bool = False) -> dict[str, Path]:
    """Return the videos of exactly one folder by name. Arguments and errors are those of `video_files`.

    A folder with videos that are named as those beside it holds copies of all cameras, and not the parts of one.
    """
    files: dict[str, Path] = {}
    entries = list_folder(folder)
    beside = {entry.stem for entry in entries if entry.suffix.lower() in VIDEO_SUFFIXES and not entry.is_dir()}
    for entry in entries:
        if entry.suffix.lower() in VIDEO_SUFFIXES and not entry.is_dir():
            name = entry.stem
        elif segmented and entry.is_dir() and (parts := segment_files(entry)):
            if beside & {part.stem for part in parts}:
                continue
            name = entry.name
        else:
            continue
        if name in files:
            raise CaptureError(
                f"{folder}: {files[name].name} and {entry.name} are both videos of {name}. Remove the one that is not wanted."
            )
        files[name] = entry
    return files


def unread_videos(path: Path) -> list[str]:
    """Return a sentence about videos of a folder whose formats are not read."""
    folders = dict.fromkeys(path / folder for folder in VIDEOS)
    files = [file for folder in folders for file in list_folder(folder) if OTHER_VIDEOS.fullmatch(file.suffix)]
    if not files:
        return []
    named = listed([file.name for file in files])
    kinds = ", ".join(sorted({file.suffix.lower() for file in files}))
    return [f"not read: {named}. Convert {kinds} to .mp4 or .mov, with the same times of the frames"]


def camera_folders(path: Path) -> dict[str, list[Path]]:
    """Return the images in subfolders of a capture by name: CAMERA/*.png or CAMERA/images/*.png, without `images` itself."""
    found = {}
    for folder in list_folder(path):
        if folder.is_dir() and not folder.name.startswith("images"):
            files = image_files(folder) or image_files(folder / "images")
            if files:
                found[folder.name] = files
    return found


def _named_by_folder(path: Path, cameras: list[ModelCamera], single: int) -> list[ModelCamera]:
    """Name cameras by their folders if each folder holds more than `single` images of one camera."""
    parents = [str(PurePosixPath(camera.name).parent) for camera in cameras]
    own = len(set(parents)) == len(parents) and "." not in parents
    folders = [path, *(folder for folder in list_folder(path) if folder.name.startswith("images"))]
    if own and any(len(image_files(folder / parents[0])) > single for folder in folders):
        return [replace(camera, name=parent) for camera, parent in zip(cameras, parents, strict=True)]
    return cameras


def _renamed(model: Model, cameras: list[ModelCamera], files: dict[str, Any], notes: list[str]) -> list[ModelCamera]:
    """Name cameras by the files with the same number, if no file has the name of a camera.

    4DGaussians calls the image of the folder `cam01` `image1.jpg`. In other models all cameras must have a file, and all
    files a camera, since counting may begin at 0 or 1.
    """
    names = [camera.name for camera in cameras]
    if not files or any(name in files for name in names):
        return cameras
    wanted, there = _by_number(names), _by_number(list(files))
    matches = set(wanted) <= set(there) if model.folder.name == "sparse_" else set(wanted) == set(there)
    if len(wanted) < len(names) or len(there) < len(files) or not matches:
        return cameras
    pairs = {name: there[number] for number, name in wanted.items()}
    notes.append(
        f"cameras of the model belong to the files with their numbers, such as {names[0]} to {pairs[names[0]]}"
    )
    return [replace(camera, name=pairs[camera.name]) for camera in cameras]


def _by_number(names: list[str]) -> dict[int, str]:
    """Return names by their last numbers. Of equal numbers only one is kept."""
    numbers = {name: re.findall("[0-9]+", name) for name in names}
    return {int(found[-1]): name for name, found in numbers.items() if found}


def _unused(files: dict[str, Path], names: list[str]) -> list[str]:
    extra = [file.name for name, file in files.items() if name not in names]
    return [f"not used, since the model has no such cameras: {', '.join(extra)}"] if extra else []


def _of_cameras(path: Path, files: dict[str, Path], names: list[str]) -> dict[str, Path]:
    absent = [name for name in names if name not in files]
    if absent:
        raise CaptureError(
            f"{path}: the model has {len(names)} cameras, and {len(absent)} of them no video, the first is {absent[0]}; there are "
            f"{', '.join(files)}. Name each video as its image in the model, or leave cameras out "
            f"({quoted(option('--leave-out', ','.join(absent)))})."
        )
    return {name: files[name] for name in names}


def _image_folders(
    path: Path, cameras: list[ModelCamera], found: dict[str, list[Path]], usual: str, where: Files
) -> dict[tuple[int, int], dict[str, list[Path]]]:
    """Return folders with images of every camera by the size of the images of camera `usual`, as {camera: files}."""
    names = [camera.name for camera in cameras]
    folders, missing = {}, []
    choices = [(f.name, _images_of(f, cameras)) for f in list_folder(path) if f.name.startswith("images")]
    for folder, files in [*choices, (".", {name: found[name] for name in names if name in found})]:
        absent = [name for name in names if name not in files]
        if not absent:
            folders[image_size(files[usual][0], where, upright=False)] = files
        elif files or folder != ".":
            missing.append(f"{folder} lacks {len(absent)} of {len(names)}, the first is {absent[0]}")
    if not folders:
        there = f" There are {', '.join(found)}." if found else ""
        flat = [advice for folder in (path, path / "images") if (advice := flat_images(folder))]
        there += f" {flat[0]}" if flat else ""
        raise CaptureError(
            f"{path}: no folder images, images_2, ... holds the images of all {len(names)} cameras of the model"
            f"{': ' + '; '.join(missing) if missing else ''}.{there} Copy them there, or a "
            f"video of each camera, named as its image, beside the model; extensions may differ. Or leave cameras out (--leave-out)."
        )
    return folders


def _images_of(folder: Path, cameras: list[ModelCamera]) -> dict[str, list[Path]]:
    """Return the images of each camera in a folder, by its name or by the pattern of its images."""
    files = images_by_camera(folder, [camera.name for camera in cameras])
    for camera in cameras:
        if camera.pattern is not None and camera.name not in files:
            before, after = camera.pattern.split(FRAME)
            pattern = re.compile(re.escape(before) + "[0-9]+" + re.escape(after))
            names = {name: file for name, file in _all_images(folder).items() if pattern.fullmatch(name)}
            files |= {camera.name: list(names.values())} if names else {}
    return files


def images_by_camera(folder: Path, names: list[str]) -> dict[str, list[Path]]:
    """Return the images of each camera that a folder has: the image with its name, or those in the folder with its name."""
    single = _all_images(folder)
    several = {name: image_files(folder / name) for name in names}
    return {name: files for name in names if (files := [single[name]] if name in single else several[name])}


def _all_images(folder: Path, depth: int = 4) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for entry in list_folder(folder):
        if entry.is_dir() and depth:
            found |= {f"{entry.name}/{name}": file for name, file in _all_images(entry, depth - 1).items()}
        elif entry.suffix.lower() in IMAGE_SUFFIXES:
            found[entry.stem] = entry
    return found


def _points(reconstruction: Any) -> tuple[np.ndarray | None, np.ndarray | None]:
    points = [p for _, p in sorted(reconstruction.points3D.items())]
    if not points:
        return None, None
    return np.array([p.xyz for p in points], np.float32), np.array([p.color for p in points], np.float32) / 255
