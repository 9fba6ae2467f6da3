"""Detection of a capture's format, and opening of captures."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from splatreel.base.command_line import quoted
from splatreel.base.errors import CaptureError
from splatreel.base.progress import listed
from splatreel.capture.base import MIN_CAMERAS, Capture, Color, Request
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.files import list_folder, locate_files
from splatreel.capture.frame_table import load_tables
from splatreel.capture.growth import Growth
from splatreel.capture.image_sequences import flat_images
from splatreel.capture.masks import MaskedCapture, MaskFiles
from splatreel.capture.readers.calibrated import CalibratedCapture, is_calibrated
from splatreel.capture.readers.colmap import ColmapCapture, camera_folders, is_colmap, unread_videos, video_files
from splatreel.capture.readers.easyvolcap import EasyVolcapCapture, is_easyvolcap
from splatreel.capture.readers.neu3dv import Neu3DVCapture, is_neu3dv
from splatreel.capture.readers.panoptic import PanopticCapture, is_panoptic
from splatreel.capture.readers.technicolor import TechnicolorCapture, is_technicolor
from splatreel.capture.readers.transforms import TransformsCapture, is_transforms
from splatreel.capture.sidecar import calibration_error

LOOKED_FOR = """\
  Neu3DV:          poses_bounds.npy and cam00.mp4, cam01.mp4, ... or cam00/images/0000.png, ...
  Panoptic Sports: train_meta.json, test_meta.json and ims/
  Technicolor:     cameras_parameters.txt and SCENE_undist_FRAME_CAMERA.png
  EasyVolcap:      intri.yml, extri.yml and images/CAMERA/*.jpg or videos/CAMERA.mp4
  COLMAP:          sparse/0/cameras.bin (or .txt) and a video a camera, or images/, images_2/, ... with an image or a folder a camera
  4DGaussians:     sparse_/cameras.bin and cam01/frame_00001.jpg, ...
  transforms.json: of nerfstudio, instant-ngp or Blender, and the images that it lists
  Calibration:     a file of Anipose, FreeMoCap, Caliscope, Pose2Sim, Qualisys, OpenCV, Metashape, CMU Panoptic, RealityCapture (XMP),
                   ActorsHQ (calibration.csv), ZJU-MoCap (annots.npy) or Google Immersive (models.json),
                   and a video a camera, or a folder of images, with its name
  Videos alone:    first run `splatreel capture calibrate` on them, and `splatreel capture sync` if they do not start together"""

READERS: tuple[tuple[Callable[[Path], bool], Callable[[Path, Request], Capture]], ...] = (
    (is_neu3dv, Neu3DVCapture),
    (is_panoptic, PanopticCapture),
    (is_technicolor, TechnicolorCapture),
    (is_easyvolcap, EasyVolcapCapture),
    (is_colmap, ColmapCapture),
    (is_transforms, TransformsCapture),
    (is_calibrated, CalibratedCapture),
)


def open_capture(
    path: str | Path,
    *,
    width: int | None = None,
    scale: float | None = None,
    frames: tuple[int, int] | None = None,
    held_out: list[str] | None = None,
    growth: Growth | None = None,
    tables: Path | None = None,
    leave_out: Sequence[str] = (),
    masks: str | Path | None = None,
    background: Color | None = None,
    masked: Sequence[str] | None = None,
) -> Capture:
    """Open a capture folder of any supported format.

    Args:
        path: Folder, or its address such as `s3://BUCKET/CAPTURE`. Of a remote capture only the needed parts are
            fetched.
        width: Output width in pixels; None keeps the input's.
        scale: Output size over input size, instead of the width.
        frames: First frame and end (exclusive); None means all.
        held_out: Names of held-out cameras; None uses the format's default.
        growth: State of a capture that is still being written (`open_growing`).
        tables: File of `pack_tables`, whose videos are not scanned again. It may be missing.
        leave_out: Names of cameras that are not read at all.
        masks: Folder of masks, or its address, white where an image shows the subject; None reads the whole scene.
        background: Color outside of the masks, 0..1; None gives each camera another one, for training.
        masked: Names of the cameras whose masks are read, if there are any; None means all, and held-out cameras may have none.

    Raises:
        CaptureError: The format is unknown, or the content cannot be used.
        StorageError: The address cannot be reached.
    """
    files, folder = locate_files(path)
    known = {} if tables is None else load_tables(tables)
    request = Request(width, scale, frames, held_out, growth, files, known, frozenset(leave_out))
    for fits, reader in READERS:
        if fits(folder):
            check_files(folder)
            return _masked(reader(folder, request), masks, background, masked)
    if folder.is_dir() and (failure := calibration_error(folder)) is not None:
        raise failure
    if advice := advise(folder, is_capture):
        raise CaptureError(f"{folder}: is not a capture of a known layout. {advice}")
    state = "holds none of these" if folder.is_dir() else "is not a folder; one of these was looked for"
    raise CaptureError(f"{folder}: {state}:\n{LOOKED_FOR}")


def _masked(
    capture: Capture, masks: str | Path | None, background: Color | None, names: Sequence[str] | None
) -> Capture:
    if masks is None:
        return capture
    assert isinstance(capture, FileCapture)  # as all readers return it
    files = MaskFiles(masks, capture, names)
    return MaskedCapture(capture, files, background, files.absent)


def is_capture(folder: Path) -> bool:
    """Return True if a folder has the layout of a capture. No file is opened."""
    return any(fits(folder) for fits, _ in READERS)


@dataclass(frozen=True)
class CaptureSource:
    """Arguments of `open_capture`, with which other processes open the same capture."""

    path: str | Path
    request: dict[str, Any] = field(default_factory=dict)

    def __call__(self, tables: Path | None = None) -> Capture:
        """Open the capture."""
        return open_capture(self.path, tables=tables, **self.request)


def check_files(folder: Path, depth: int = 3) -> None:
    """Raise `CaptureError` for entries that are neither files nor folders, such as pipes, on which reading blocks."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir():
                if depth and not entry.name.startswith("."):
                    check_files(Path(entry.path), depth - 1)
            elif not entry.is_file() and os.path.exists(entry.path):
                raise CaptureError(f"{entry.path}: is neither a file nor a folder. Remove it from the capture.")


def advise(folder: Path, is_capture: Callable[[Path], bool]) -> str | None:
    """Return a sentence about what a folder holds and the command that helps, or None.

    Args:
        folder: Folder that is not a capture.
        is_capture: Function that returns whether a folder has the layout of a capture.

    Raises:
        CaptureError: Two videos have the same name.
    """
    inside = [entry for entry in list_folder(folder) if entry.is_dir()]
    if below := [entry for entry in inside if is_capture(entry)]:
        others = f"Its folders {listed([entry.name for entry in below])} look like captures: give one of them, such as {below[0]}."
        return others if len(below) > 1 else f"Its folder {below[0].name} looks like a capture: give {below[0]}."
    for place in [folder, *inside]:
        videos = video_files(place, segmented=True)
        if len(videos) >= MIN_CAMERAS:
            return (
                f"{place} holds {len(videos)} videos ({listed(list(videos))}) without poses of their cameras. If they do not start "
                f"together, run `{_command('sync', place)}`. Then run `{_command('calibrate', place)}`."
            )
    for place in [folder, *inside]:
        if others := unread_videos(place):
            return f"Videos in {place} are {others[0]}."
    for place in [folder, *inside]:
        images = camera_folders(place)
        if len(images) >= MIN_CAMERAS:
            return (
                f"{place} holds images of {len(images)} cameras ({listed(list(images))}) without poses of these cameras. Run "
                f"`{_command('calibrate', place)}`."
            )
    return next((advice for place in [folder, *inside] if (advice := flat_images(place))), None)


def _command(verb: str, folder: Path) -> str:
    return quoted(["splatreel", "capture", verb, folder])
