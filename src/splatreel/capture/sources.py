"""Choice of a frame source: complete files, or files that are still being written."""

from __future__ import annotations

from pathlib import Path

from splatreel.capture.base import Request
from splatreel.capture.growing.growing_pictures import GrowingPictures
from splatreel.capture.growing.growing_videos import GrowingCamera, GrowingVideos
from splatreel.capture.image_sequences import ImageSequences, in_order
from splatreel.capture.sidecar import Sidecar
from splatreel.capture.video import VideoFile
from splatreel.capture.videos import Videos

Video = VideoFile | GrowingCamera


def video_source(path: Path, files: dict[str, Path], sidecar: Sidecar, request: Request) -> Videos | GrowingVideos:
    """Return the source for a video per camera, or a folder of numbered videos per camera while they are being written."""
    if request.growth is None:
        return Videos(path, files, sidecar, request)
    return GrowingVideos(path, files, sidecar, request.growth)


def picture_source(
    path: Path, files: dict[str, list[Path]], sidecar: Sidecar, request: Request
) -> ImageSequences | GrowingPictures:
    """Return the source for the images of each camera in order of time."""
    if request.growth is None:
        ordered = {name: in_order(found, request) for name, found in files.items()}
        return ImageSequences(path, ordered, sidecar, request)
    return GrowingPictures(path, files, sidecar)
