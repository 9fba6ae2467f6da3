"""Choice of a frame source: complete files, or files that are still being written."""

from __future__ import annotations

from pathlib import Path

from splatreel.capture.base import Request
from splatreel.capture.growing.growing_images import GrowingImages
from splatreel.capture.growing.growing_videos import GrowingCamera, GrowingVideos
from splatreel.capture.growing.growth import is_recorded
from splatreel.capture.image_pairs import pair_images
from splatreel.capture.image_sequences import ImageSequences
from splatreel.capture.sidecar import Sidecar
from splatreel.capture.video import VideoFile
from splatreel.capture.videos import Videos

Video = VideoFile | GrowingCamera


def video_source(path: Path, files: dict[str, Path], sidecar: Sidecar, request: Request) -> Videos | GrowingVideos:
    """Return the source for a video per camera, or a folder of numbered videos per camera while they are being written."""
    files = {name: file for name, file in files.items() if name not in request.left_out}
    sidecar = sidecar.only({*sidecar.starts, *sidecar.rates} - request.left_out)
    if request.growth is None:
        return Videos(path, files, sidecar, request)
    return GrowingVideos(path, files, sidecar, request.growth)


def image_source(
    path: Path, files: dict[str, list[Path]], sidecar: Sidecar, request: Request, *, upright: bool = True
) -> ImageSequences | GrowingImages:
    """Return the source for the images of each camera, which are paired by the numbers in their names.

    `upright` obeys EXIF.
    """
    files = {name: found for name, found in files.items() if name not in request.left_out}
    if request.growth is None:
        pairs = pair_images(path, files, all_have=is_recorded(path))
        return ImageSequences(path, pairs.files, sidecar, request, pairs.notes, pairs.labels, upright=upright)
    return GrowingImages(path, files, sidecar, upright=upright)
