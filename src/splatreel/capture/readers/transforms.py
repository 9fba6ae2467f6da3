"""Captures described by `transforms.json`: nerfstudio, instant-ngp, NeRF's synthetic scenes and Blender's add-on BlenderNeRF.

A frame has a `file_path`, a `transform_matrix` from camera to world in OpenGL's axes (x right, y up, z backwards), and
sometimes a `time`. The lens is that of the file or of the frame: `fl_x`, `fl_y`, `cx`, `cy` in pixels of a `w` x `h`
image, or `camera_angle_x` in radians, with k1, k2, k3, k4, p1, p2. The center of the first pixel is at (0.5, 0.5).
`transforms_train.json` and `transforms_test.json` share this format; the cameras of the second are held out.

Frames of one pose are the images of one camera, in order of `time`, otherwise of their names. If each frame has a pose
and a folder of its own, the folder's images are the camera's. Otherwise each frame is a camera with one time step.

Source: nerfstudio (commit 50e0e3c), `docs/quickstart/data_conventions.md`, `nerfstudio_dataparser.py`, `camera_utils.py`
(distortion); instant-ngp (commit abe236e), `src/nerf_loader.cu`; BlenderNeRF (commit 30e6691), `blender_nerf_operator.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from splatreel.base.command_line import option, quoted
from splatreel.base.errors import CaptureError, GaussiansError
from splatreel.base.ply_table import read_elements
from splatreel.base.untrusted import is_number, numbers, read_json
from splatreel.capture.base import Request
from splatreel.capture.files import natural_key
from splatreel.capture.image_sequences import IMAGE_SUFFIXES, image_files
from splatreel.capture.readers.calibrated import CalibratedCapture
from splatreel.capture.readers.calibrations.calibrated_rig import Rig, RigCamera, brown_lens, image_size, naming, pose
from splatreel.capture.readers.calibrations.media import Media, find_media
from splatreel.capture.readers.colmap_model import import_pycolmap
from splatreel.capture.video import VIDEO_SUFFIXES

PERSPECTIVE = ("", "PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "RADIAL", "SIMPLE_RADIAL", "OPENCV")
FISHEYE = "OPENCV_FISHEYE"
OTHER = ("ftheta_p0", "latlong", "equirectangular", "orthographic")
"""Keys of instant-ngp for lenses that are not read."""


def transforms_lens(whose: str, values: dict[str, Any]) -> tuple[tuple[int, int] | None, Callable[[int, int], Any]]:
    """Return the image size, or None, and the function that makes the lens for the size of the images.

    Args:
        whose: Camera, for messages.
        values: Values of the file, replaced by those of the frame.
    """
    model = str(values.get("camera_model", "")).upper()
    if values.get("is_fisheye"):
        model = FISHEYE
    other = [key for key in OTHER if values.get(key)]
    if other or model not in (*PERSPECTIVE, FISHEYE):
        raise CaptureError(
            f"{whose}: has the lens {other[0] if other else model}, which is not read. Read are perspective and {FISHEYE}: undistort "
            f"the images first."
        )
    with naming(whose):
        size = image_size([_number(values, "w"), _number(values, "h")]) if "w" in values and "h" in values else None
        listed = values.get("distortion_params")
        k1, k2, k3, k4, p1, p2 = (
            [_number(values, key) for key in ("k1", "k2", "k3", "k4", "p1", "p2")]
            if listed is None
            else [float(value) for value in listed]
        )
    if model == FISHEYE and (p1 or p2):
        raise CaptureError(f"{whose}: is a fisheye with p1 {p1:g} and p2 {p2:g}, which {FISHEYE} lacks. Set them to 0.")

    def lens(width: int, height: int) -> Any:
        width, height = size or (width, height)
        with naming(whose):
            fx, fy = _focal_lengths(values, width, height)
            pinhole = [fx, fy, _number(values, "cx", width / 2), _number(values, "cy", height / 2)]
        if model != FISHEYE:
            return brown_lens(whose, (width, height), pinhole, [k1, k2, k3, k4], [p1, p2])
        return import_pycolmap().Camera(model=FISHEYE, width=width, height=height, params=[*pinhole, k1, k2, k3, k4])

    return size, lens


def _focal_lengths(values: dict[str, Any], width: int, height: int) -> tuple[float, float]:
    """Return both focal lengths in pixels. One of them is used for both where the other is missing."""
    found = []
    for axis, side in (("x", width), ("y", height)):
        if f"fl_{axis}" in values:
            found.append(_number(values, f"fl_{axis}"))
        elif f"camera_angle_{axis}" in values:
            found.append(side / 2 / math.tan(_number(values, f"camera_angle_{axis}") / 2))
        elif f"{axis}_fov" in values:
            found.append(side / 2 / math.tan(math.radians(_number(values, f"{axis}_fov")) / 2))
        else:
            found.append(0.0)
    fx, fy = found[0] or found[1], found[1] or found[0]
    if min(fx, fy) <= 0:
        raise ValueError("it has no positive focal length fl_x, nor a camera_angle_x")
    return fx, fy


def _number(values: dict[str, Any], key: str, default: float = 0.0) -> float:
    value = values.get(key, default)
    if not is_number(value):
        raise ValueError(f"{key} is {value!r:.40}, not a number")
    return float(value)


META, TRAIN, TEST = "transforms.json", "transforms_train.json", "transforms_test.json"
META_BYTES, META_VALUES = 256 << 20, 10_000_000
"""Maximum size of such a file: every frame has a pose."""
SHUTTERS = ("rolling_shutter", "rolling_shutter_time")
"""Keys of instant-ngp and of nerfstudio for rows that show different moments."""
MASK = "mask_path"
"""Key of nerfstudio for the mask of a frame."""
SAME_POSE = 1e-5
"""Maximum difference between the matrices of one camera's frames, relative to the largest number in them."""
POINTS = "points3d.ply"
"""Points that BlenderNeRF writes."""


@dataclass(frozen=True)
class _Frame:
    file: str
    """File below the capture's folder, with slashes."""
    matrix: np.ndarray
    """Camera to world in OpenGL's axes, [4, 4]."""
    time: float | None
    lens: dict[str, Any]
    held_out: bool


@dataclass(frozen=True)
class _View:
    """Frames of one camera in order of time; None at times for which it has none."""

    name: str
    frames: list[_Frame | None]

    @property
    def first(self) -> _Frame:
        """First existing frame."""
        return next(frame for frame in self.frames if frame is not None)


def is_transforms(path: Path) -> bool:
    """Return whether a folder holds a transforms.json."""
    return any((path / name).is_file() for name in (META, TRAIN))


class TransformsCapture(CalibratedCapture):
    """Folder with a transforms.json. By default the cameras of the test split are held out, otherwise a middle camera."""

    def __init__(self, path: Path, request: Request) -> None:
        file = path / META if (path / META).is_file() else path / TRAIN
        rig, views = _read(file)
        media, timed = _media(path, views, rig, request.left_out)
        super().__init__(path, request, rig, media, layout="transforms.json", paired=timed, upright=False)


def read_transforms(file: Path) -> Rig:
    """Return the cameras of a transforms.json."""
    return _read(file)[0]


def _read(file: Path) -> tuple[Rig, list[_View]]:
    frames, points = _frames(file)
    if file.name == TRAIN and (file.parent / TEST).is_file():
        frames += _frames(file.parent / TEST)[0]
    if not frames:
        raise CaptureError(f"{file}: lists no frames. Export the cameras again.")
    views = _views(file, frames)
    cameras = [_camera(file, view) for view in views]
    held_out = [view.name for view in views if view.first.held_out]
    positions, colors = _points(points)
    return Rig(file, cameras, positions, colors, held_out or None, _ignored(file, frames, views)), views


def _ignored(file: Path, frames: list[_Frame], views: list[_View]) -> list[str]:
    shutters = [frame.lens.get(key) for frame in frames for key in SHUTTERS]
    used = [values for values in shutters if values and (not isinstance(values, list) or any(values))]
    found = []
    if used:
        found.append(f"{file}: rolling_shutter {used[0]!r:.60} is not read: each image is taken to show one moment")
    if masked := sum(bool(frame.lens.get(MASK)) for frame in frames):
        found.append(
            f"{file}: {MASK} of {masked} of {len(frames)} frames is not read: all that the images show is reconstructed. For the "
            f"subject of the masks, {_masks_option(file, views)}"
        )
    return found


def _masks_option(file: Path, views: list[_View]) -> str:
    folders = set()
    for view in views:
        parts = PurePosixPath(view.name).parts
        for frame in view.frames:
            if frame is None:
                continue
            mask = frame.lens.get(MASK)
            place = PurePosixPath(mask.replace("\\", "/")) if isinstance(mask, str) else PurePosixPath()
            fitting = [own for own in (place.parent, place.parent / place.stem) if own.parts[-len(parts) :] == parts]
            folders.add(fitting[0].parents[len(parts) - 1] if fitting else None)
    folder = folders.pop() if len(folders) == 1 else None
    if folder is None or not (file.parent / folder).is_dir():
        return "copy the masks of each camera into a folder of its name, and give their folder as --masks"
    return f"give {quoted(option('--masks', file.parent / folder))}"


def _frames(file: Path) -> tuple[list[_Frame], Path | None]:
    meta = read_json(file, CaptureError, META_BYTES, META_VALUES)
    with naming(str(file)):
        tests = set(meta.get("test_filenames", []))
        general = {key: value for key, value in meta.items() if key != "frames"}
        frames = [
            _frame(file, number, entry, general, tests, file.name == TEST)
            for number, entry in enumerate(meta["frames"])
        ]
        kept = [
            frame for frame in frames if "sharpness" not in frame.lens or _existing(file.parent / frame.file).is_file()
        ]
        named = meta.get("ply_file_path")
        points = file.parent / str(named) if named is not None else file.parent / POINTS
    if named is not None and not points.is_file():
        raise CaptureError(f"{points}: is missing, though {file.name} names it as the points. Copy it there.")
    # colmap2nerf.py rates the sharpness of images, and instant-ngp skips those that were then deleted.
    return kept or frames, points if points.is_file() else None


def _frame(
    file: Path, number: int, entry: dict[str, Any], general: dict[str, Any], tests: set[str], is_test: bool
) -> _Frame:
    with naming(f"{file}: frame {number}"):
        path, rows, time = entry["file_path"], entry["transform_matrix"], entry.get("time")
        matrix = np.eye(4)
        matrix[: len(rows)] = numbers(rows, 3 if len(rows) == 3 else 4, 4)
        if not isinstance(path, str) or not path or (time is not None and not is_number(time)):
            raise ValueError(f"its file_path is {path!r:.100} and its time {time!r:.40}")
        place = PurePosixPath(path.replace("\\", "/")).as_posix()
    return _Frame(place, matrix, time, general | entry, is_test or path in tests)


def _views(file: Path, frames: list[_Frame]) -> list[_View]:
    groups = _by_pose(frames)
    times = {frame.time for frame in frames if frame.time is not None}
    if len(times) > 1 and len(groups) > max(len(frames) / 2, 1):
        raise CaptureError(
            f"{file}: its {len(frames)} images have {len(times)} times and {len(groups)} poses: the camera moves, as in D-NeRF. Only "
            f"static cameras that film together can be reconstructed."
        )
    views = []
    for name, group in zip(_names([[frame.file for frame in group] for group in groups]), groups, strict=True):
        if times:
            own = {frame.time: frame for frame in group}
            if None in own or len(own) < len(group):
                raise CaptureError(
                    f"{file}: camera {name} has {len(group)} images with {len(own)} different times. Each image needs its own "
                    f"time: correct the list of frames."
                )
            views.append(_View(name, [own.get(time) for time in sorted(times)]))
        else:
            ordered = sorted(group, key=lambda frame: natural_key(frame.file))
            views.append(_View(name, [*ordered]))
    return sorted(views, key=lambda view: natural_key(view.name))


def _by_pose(frames: list[_Frame]) -> list[list[_Frame]]:
    groups: list[list[_Frame]] = []
    poses = np.zeros((0, 4, 4))
    for frame in frames:
        near = np.abs(poses - frame.matrix).max((1, 2)) <= SAME_POSE * max(np.abs(frame.matrix).max(), 1.0)
        if near.any():
            groups[int(near.argmax())].append(frame)
        else:
            groups.append([frame])
            poses = np.concatenate([poses, frame.matrix[None]])
    return groups


def _names(files: list[list[str]]) -> list[str]:
    """Return a name for each camera: its folder if no other camera has it, otherwise the stem of its first file."""
    folders = [{str(PurePosixPath(file).parent) for file in own} for own in files]
    single = [own.pop() if len(own) == 1 else "" for own in folders]
    if "" not in single and "." not in single and len(set(single)) == len(single):
        return _shortest([PurePosixPath(folder).parts for folder in single])
    return _shortest([PurePosixPath(own[0]).with_suffix("").parts for own in files])


def _shortest(parts: list[tuple[str, ...]]) -> list[str]:
    """Return paths without the folders that all of them are in."""
    common = 0
    while all(len(own) > common + 1 for own in parts) and len({own[common] for own in parts}) == 1:
        common += 1
    return ["/".join(own[common:]) for own in parts]


def _camera(file: Path, view: _View) -> RigCamera:
    frame, whose = view.first, f"{file}: camera {view.name}"
    size, lens = transforms_lens(whose, frame.lens)
    axes = frame.matrix[:3, :3] @ np.diag([1.0, -1, -1])
    return RigCamera(view.name, pose(whose, axes.T, -axes.T @ frame.matrix[:3, 3]), size, lens)


def _media(path: Path, views: list[_View], rig: Rig, left_out: frozenset[str]) -> tuple[Media, bool]:
    """Return the files of each camera, and whether they are in order of time.

    Where no listed file exists, the files with the cameras' names are returned.
    """
    views = [view for view in views if view.name not in left_out]
    found = {
        view.name: [None if frame is None else _existing(path / frame.file) for frame in view.frames] for view in views
    }
    listed = [file for files in found.values() for file in files if file is not None]
    if not any(file.is_file() for file in listed):
        return find_media(path, [view.name for view in views], rig.origin), False
    missing = [file for file in listed if not file.is_file()]
    if missing:
        raise CaptureError(
            f"{missing[0]}: is missing, and so are {len(missing) - 1} more of the {len(listed)} files that {rig.origin.name} lists. "
            f"Copy them there."
        )
    first = {view.name: _existing(path / view.first.file) for view in views}
    if len(listed) == len(views):
        if all(file.suffix.lower() in VIDEO_SUFFIXES for file in listed):
            return first, False
        if len(views) == len({file.parent for file in listed}):
            return {name: list(image_files(file.parent)) for name, file in first.items()}, False
    return found, any(frame.time is not None for view in views for frame in view.frames if frame is not None)


def _existing(file: Path) -> Path:
    """Return an image, with the extension that the file on the disk has if the name has none."""
    if file.is_file():
        return file
    return next((known for suffix in IMAGE_SUFFIXES if (known := file.with_name(file.name + suffix)).is_file()), file)


def _points(file: Path | None) -> tuple[np.ndarray | None, np.ndarray | None]:
    if file is None:
        return None, None
    try:
        columns = read_elements(file, ("vertex",)).get("vertex", {})
    except GaussiansError as error:
        raise CaptureError(f"{error} Its points are optional: export it again or remove it.") from error
    if not all(name in columns for name in "xyz"):
        raise CaptureError(f"{file}: has no points (element vertex with x, y, z). Export it again or remove it.")
    positions = np.stack([columns[name] for name in "xyz"], 1).astype(np.float32)
    kept = np.isfinite(positions).all(1)
    if not kept.any():
        return None, None
    channels = [columns[name][kept] for name in ("red", "green", "blue") if name in columns]
    return positions[kept], _colors(np.stack(channels, 1)) if len(channels) == 3 else None


def _colors(channels: np.ndarray) -> np.ndarray:
    """Return colors as float32 from 0 to 1. Integers fill the range of their type; other numbers are 0..1 or 0..255."""
    floats = 255 if np.nanmax(channels, initial=0) > 1 else 1
    most = np.iinfo(channels.dtype).max if channels.dtype.kind in "iu" else floats
    return np.clip(np.nan_to_num(channels.astype(np.float32) / most), 0, 1)
