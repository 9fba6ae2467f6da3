"""Advice for folders in which no capture is found, from what they hold."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from splatreel.base.command_line import quoted
from splatreel.capture.base import MIN_CAMERAS
from splatreel.capture.files import list_folder
from splatreel.capture.image_sequences import flat_images
from splatreel.capture.readers.colmap import camera_folders, unread_videos, video_files

MOST_NAMED = 4
"""Maximum number of files that a sentence lists."""


def advise(folder: Path, is_capture: Callable[[Path], bool]) -> str | None:
    """Return a sentence about what a folder holds and the command that helps, or None.

    Args:
        folder: Folder that is not a capture.
        is_capture: Function that returns whether a folder has the layout of a capture.

    Raises:
        CaptureError: Two videos have the same name.
    """
    inside = [entry for entry in list_folder(folder) if entry.is_dir()]
    if below := next((entry for entry in inside if is_capture(entry)), None):
        return f"Its folder {below.name} looks like a capture: give {below}."
    for place in [folder, *inside]:
        videos = video_files(place, segmented=True)
        if len(videos) >= MIN_CAMERAS:
            return (
                f"{place} holds {len(videos)} videos ({_listed(list(videos))}) without poses of their cameras. If they do not start "
                f"together, run `{_command('sync', place)}`. Then run `{_command('calibrate', place)}`."
            )
    for place in [folder, *inside]:
        if others := unread_videos(place):
            return f"Videos in {place} are {others[0]}."
    for place in [folder, *inside]:
        images = camera_folders(place)
        if len(images) >= MIN_CAMERAS:
            return (
                f"{place} holds images of {len(images)} cameras ({_listed(list(images))}) without poses of these cameras. Run "
                f"`{_command('calibrate', place)}`."
            )
    return next((advice for place in [folder, *inside] if (advice := flat_images(place))), None)


def _command(verb: str, folder: Path) -> str:
    return quoted(["splatreel", "capture", verb, folder])


def _listed(names: list[str]) -> str:
    return ", ".join(names[:MOST_NAMED]) + (", ..." if len(names) > MOST_NAMED else "")
