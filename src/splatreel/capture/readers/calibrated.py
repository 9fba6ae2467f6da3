"""Captures of a calibration file from another program, and videos or images beside it.

The formats are those of `FORMATS`. The calibration is in the capture's folder, in a folder of it named like `calibration` or
`S00_Calibration`, or in those of a folder above, as motion capture programs calibrate a session of several recordings. Videos and
images belong to the cameras by their names (`calibrations/media.py`).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import open_regular
from splatreel.capture.base import Request
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.files import list_folder
from splatreel.capture.image_sequences import ImageSequences, image_source
from splatreel.capture.lens import Lens, common_size, undistorted_camera
from splatreel.capture.readers.calibrations.calibrated_rig import Rig, RigCamera
from splatreel.capture.readers.calibrations.datasets import (
    is_actorshq,
    is_immersive,
    is_panoptic_studio,
    is_zju_mocap,
    read_actorshq,
    read_immersive,
    read_panoptic_studio,
    read_zju_mocap,
)
from splatreel.capture.readers.calibrations.media import SHARED, Media, find_media, has_media
from splatreel.capture.readers.calibrations.metashape import is_metashape, read_metashape
from splatreel.capture.readers.calibrations.motion_capture import is_qualisys, is_toml, read_qualisys, read_toml
from splatreel.capture.readers.calibrations.opencv import is_camera, is_multiview, read_cameras, read_multiview
from splatreel.capture.readers.calibrations.realitycapture import read_realitycapture, xmp_folders
from splatreel.capture.sidecar import read_sidecar
from splatreel.capture.videos import video_source
from splatreel.scene.camera import middle_camera

HEAD = 1 << 16
"""Bytes of a file by which its format is recognized."""
FORMATS: tuple[tuple[str, Callable[[Path, bytes], bool], Callable[[Path], Rig]], ...] = (
    ("TOML", is_toml, read_toml),
    ("Qualisys", is_qualisys, read_qualisys),
    ("Metashape", is_metashape, read_metashape),
    ("Panoptic Studio", is_panoptic_studio, read_panoptic_studio),
    ("OpenCV", is_multiview, read_multiview),
    ("Google Immersive", is_immersive, read_immersive),
    ("ActorsHQ", is_actorshq, read_actorshq),
    ("ZJU-MoCap", is_zju_mocap, read_zju_mocap),
)
"""Name, recognition by the start of a file, and reader of each format of one file."""
RESULT = "capture_volume"
"""Folder of Caliscope's complete calibration. The one at the top of the session may be older, or hold lenses only."""
CALIBRATION_FOLDERS = ("[cC]alib*", "S[0-9]*_[cC]alib*", f"[cC]alib*/extrinsic/{RESULT}")
"""Folders of a capture or of a session that may hold a calibration."""
SUFFIXES = (".toml", ".txt", ".xml", ".json", ".yml", ".yaml", ".csv", ".npy")
IN_METERS = ("Qualisys", "ZJU-MoCap")
"""Formats whose readers return meters. The unit of the other formats is unknown."""
PADDING, ROUNDING = 16, 1.0
"""Pixels by which codecs fill up images, and by which the size of a resized image may be rounded."""
LEVELS = 3
"""Number of folders above a recording that are searched for a calibration."""
SAME_PLACE = 1e-3
"""Maximum difference between two poses for two files to be the same calibration."""


@dataclass(frozen=True)
class _Calibration:
    """Recognized calibration."""

    layout: str
    origin: Path
    read: Callable[[], Rig]


def is_calibrated(path: Path) -> bool:
    """Return whether a folder holds a calibration file of another program, or videos of a calibration in a folder above."""
    return next(_calibrations(path), None) is not None or bool(_calibrations_above(path))


def read_rig(file: Path) -> Rig | None:
    """Return the cameras of a calibration file, or None if its format is unknown."""
    found = next(_recognized([file]), None)
    return None if found is None else found.read()


class CalibratedCapture(FileCapture):
    """Calibration of another program with videos or images. By default a middle camera is held out.

    Args:
        path: Folder of the capture.
        request: Options.
        rig: Its calibration; None searches for it.
        media: Videos or images by camera; None searches for them.
        layout: Name of the format.
        paired: True if the images of each camera are in order of time; None where a camera has none.
        upright: True obeys EXIF's orientation, unless the calibration's size speaks against it.
    """

    def __init__(
        self,
        path: Path,
        request: Request,
        rig: Rig | None = None,
        media: Media | None = None,
        layout: str = "",
        paired: bool = False,
        upright: bool = True,
    ) -> None:
        if rig is None:
            layout, rig = read_calibration(path)
        self._layout = layout
        names = rig.names()
        if not names or len(set(names)) < len(names):
            problem = "two cameras have one name" if names else "no camera has a pose"
            raise CaptureError(f"{rig.origin}: {problem} ({', '.join(names) or 'none'}). Export the calibration again.")
        if media is None:
            wanted = [name for name in names if name not in request.left_out]
            media = find_media(path, wanted, rig.origin, rig.partial)
        views = [c for c in rig.cameras if c.name in media and c.name not in request.left_out]
        sidecar, names = read_sidecar(path), [camera.name for camera in views]
        videos = {name: file for name, file in media.items() if isinstance(file, Path)}
        notes = list(rig.notes)
        if any(file.parent == path / folder for file in videos.values() for folder in SHARED):
            notes.append(f"there is no recording: the videos are those of the calibration, in {', '.join(SHARED)}")
        if videos:
            source = video_source(path, {name: videos[name] for name in names}, sidecar, request)
        else:
            images = {name: files for name in names if not isinstance(files := media[name], Path)}
            existing = {name: [file for file in files if file is not None] for name, files in images.items()}
            source = (
                ImageSequences(path, images, sidecar, request, upright=upright)
                if paired
                else image_source(path, existing, sidecar, request, upright=upright)
            )
        sizes = {view.name: source.size(view.name, view.size) for view in views}
        width, height = request.size(*common_size(list(sizes.values())), path)
        lenses: dict[str, Lens] = {}
        calibrated: dict[str, tuple[int, int]] = {}
        cameras = []
        for view in views:
            whose, fit = f"{rig.origin}: camera {view.name}", fitting_lens(view, sizes[view.name], rig.origin, notes)
            if view.size is not None:
                calibrated[view.name] = fit.width, fit.height
            camera, lens = undistorted_camera(view.name, view.viewmat, fit, width, height, whose)
            cameras.append(camera)
            if lens is not None:
                lenses[view.name] = lens
        first, _ = request.range(source.frames, path)
        absent = [name for name in rig.names() if name not in media and name not in request.left_out]
        if absent:
            notes.append(f"{len(absent)} cameras of {rig.origin.name} have no videos and are left out")
        default = [names[middle_camera(cameras)]] if rig.held_out is None else rig.held_out
        super().__init__(
            path,
            cameras,
            source,
            replace(request, left_out=request.left_out - set(rig.names())),
            held_out=[name for name in default if name in names] if sidecar.held_out is None else sidecar.held_out,
            lenses=lenses,
            points=rig.points if first == 0 else None,
            point_colors=rig.point_colors if first == 0 else None,
            origin=rig.origin,
            calibrated=calibrated,
            notes=notes,
        )

    @property
    def layout(self) -> str:
        """Name of the calibration's format."""
        return self._layout


def fitting_lens(view: RigCamera, size: tuple[int, int], origin: Path, notes: list[str]) -> Any:
    """Return the lens of a camera whose images have a size.

    Codecs fill images up to a multiple of 16 pixels at the right and at the bottom. A calibration that still has these
    pixels is cropped, and a note says so.

    Raises:
        CaptureError: The images have another aspect ratio than the calibration.
    """
    lens = view.lens(*size)
    if view.size is None or abs(view.size[0] * size[1] / view.size[1] - size[0]) <= ROUNDING:
        return lens
    differences = abs(view.size[0] - size[0]), abs(view.size[1] - size[1])
    whose = f"{origin}: camera {view.name} is calibrated for {view.size[0]}x{view.size[1]}, but its images are {size[0]}x{size[1]}"
    if min(differences) == 0 and max(differences) < PADDING:
        notes.append(f"{whose}; the pixels at the right and at the bottom are taken to be cut off")
        lens = copy.deepcopy(lens)
        lens.width, lens.height = size
        return lens
    turned = abs(view.size[1] * size[1] / view.size[0] - size[0]) <= ROUNDING
    raise CaptureError(
        f"{whose}, {'turned by a quarter' if turned else 'another aspect ratio'}. {'Turn' if turned else 'Crop'} them as for the "
        f"calibration, or calibrate again."
    )


def _calibrations_above(path: Path) -> list[_Calibration]:
    """Return the calibrations in the nearest folder above that has one with cameras whose media are in this folder."""
    if not path.is_dir():
        return []
    for folder in path.absolute().parents[:LEVELS]:
        found = list(_calibrations(folder, above=True))
        if any(has_media(path, one.read().names()) for one in found):
            return found
    return []


def _calibrations(path: Path, above: bool = False) -> Iterator[_Calibration]:
    """Yield calibrations in a folder. `above`: it is not the capture's own, so that only TOML files count in the folder itself."""
    if not path.is_dir():
        return
    inside = sorted(entry for pattern in CALIBRATION_FOLDERS for entry in path.glob(pattern) if entry.is_dir())
    for folder in [path, *inside]:
        suffixes = (".toml",) if above and folder == path else SUFFIXES
        files = [file for file in list_folder(folder) if file.suffix.lower() in suffixes and file.is_file()]
        yield from _recognized(files)
        single = [file for file in files if is_camera(file, _head(file))]
        if single:
            yield _Calibration("OpenCV", folder, lambda single=single: read_cameras(single))
    for folder in [] if above else xmp_folders(path):
        yield _Calibration("RealityCapture", folder, lambda folder=folder: read_realitycapture(folder))


def _recognized(files: list[Path]) -> Iterator[_Calibration]:
    for file in files:
        head = _head(file)
        for layout, is_format, read in FORMATS:
            if is_format(file, head):
                yield _Calibration(layout, file, lambda read=read, file=file: read(file))


def _head(file: Path) -> bytes:
    try:
        with open_regular(file, CaptureError) as opened:
            return opened.read(HEAD)
    except OSError:
        return b""


def read_calibration(path: Path) -> tuple[str, Rig]:
    """Return the format and the cameras of the calibration in a folder, or in one above.

    Raises:
        CaptureError: There is none, or there are two that differ.
    """
    own = list(_calibrations(path))
    found = [(one, one.read()) for one in own or _calibrations_above(path)]
    if not found:
        raise CaptureError(f"{path}: holds no calibration file. Copy it there.")
    found = [(one, cameras) for one, cameras in found if cameras.cameras] or found  # others hold lenses only
    found = [fit for fit in found if fit[0].origin.parent.name == RESULT] or found
    first, rig = found[0]
    if not own:
        rig.notes.append(f"the calibration is {first.origin}, in a folder above the recording")
    for other, cameras in found[1:]:
        if not _agree(rig, cameras):
            raise CaptureError(
                f"{path}: has two calibrations, {_shown(first, path)} and {_shown(other, path)}, whose cameras differ. Remove the "
                f"wrong one, or copy the right one into the folder of the videos."
            )
    return first.layout, rig


def _shown(calibration: _Calibration, path: Path) -> Path:
    origin = calibration.origin
    return origin.relative_to(path) if origin.is_relative_to(path) else origin


def _agree(one: Rig, other: Rig) -> bool:
    if sorted(one.names()) != sorted(other.names()):
        return False
    named = {camera.name: camera for camera in other.cameras}
    return all(_is_same(camera, named[camera.name]) for camera in one.cameras)


def _is_same(one: RigCamera, other: RigCamera) -> bool:
    if one.size != other.size or not np.allclose(one.viewmat, other.viewmat, atol=SAME_PLACE):
        return False
    lenses = [np.asarray(camera.lens(*(one.size or (1, 1))).params) for camera in (one, other)]
    return lenses[0].shape == lenses[1].shape and np.allclose(*lenses, rtol=SAME_PLACE, atol=SAME_PLACE)
