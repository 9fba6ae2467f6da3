"""`splatreel capture masks`, and `--masks auto` of `splatreel reconstruct`."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from splatreel.base.command_line import quoted
from splatreel.base.display import console
from splatreel.base.errors import UsageError
from splatreel.base.threads import use as use_threads
from splatreel.cli.options import CaptureAddress, check_out, parse_frames, parse_left_out
from splatreel.cli.printing import counted, say

if TYPE_CHECKING:
    from splatreel.capture.opening import CaptureSource

AUTO = "auto"
"""Value of --masks that makes masks."""
WIDTH = 480
"""Largest width of masks, pixels. Masks of smaller images have the width of these."""


def capture_masks(
    capture: CaptureAddress,
    /,
    out: Path,
    clean_plate: Path | None = None,
    width: int = WIDTH,
    frames: str | None = None,
    leave_out: str | None = None,
    threads: int | None = None,
) -> None:
    """Make masks of the people and things that move, for `reconstruct --masks`. After an interruption, the same command continues.

    Networks of people are used where they are installed, and SAM2; neither is needed. The masks belong to undistorted images,
    which `splatreel capture convert` writes. They may be corrected in any image editor.

    Args:
        capture: Folder or address of the videos or images and their cameras.
        out: New folder. It gets a folder of images for each camera, white where the images show the subject, gray where that is in
            doubt. Levels below 64 and from 192 on tell how much of a border pixel the subject fills.
        clean_plate: Folder with an image, a folder of images or a video without the subject for each camera, filmed with the same
            settings. It is needed for people who never move; by default backgrounds are found in the capture itself.
        width: Largest width of the masks, in pixels.
        frames: Frames A to B - 1, as A:B; by default all. Backgrounds are found in the whole video either way.
        leave_out: Names of cameras that are not read at all, as NAME,NAME.
        threads: Number of threads; by default one per core.
    """
    use_threads(threads)
    check_out("--out", out, capture, below=False)
    if width < 1:
        raise UsageError(f"--width {width}: give pixels, 1 or more.")
    from splatreel.capture.opening import CaptureSource

    request = {"frames": parse_frames(frames), "leave_out": parse_left_out(leave_out)}
    make_masks(CaptureSource(capture, request), out, clean_plate, width)
    say(
        f"  reconstruct the subject with\n  {quoted(['splatreel', 'reconstruct', capture, '--masks', out, '--out', 'OUT'])}"
    )


def make_masks(source: CaptureSource, folder: Path, clean_plate: Path | None, width: int = WIDTH) -> None:
    """Make the masks of a capture, or finish them, and report the result.

    Args:
        source: How to open the capture. Its size is replaced.
        folder: Folder of the masks.
        clean_plate: Folder of images without the subject.
        width: Largest width of the masks, pixels.
    """
    from splatreel.capture.file_capture import FileCapture
    from splatreel.method.images.people import find_people
    from splatreel.method.layering.sam2 import find_sam2
    from splatreel.segmentation.mask_writer import write_masks

    whole = replace(source, request=source.request | {"width": None, "scale": None})()
    own = whole.width
    capture = whole
    if own > width:
        whole.close()
        capture = replace(source, request=source.request | {"width": width, "scale": None})()
    assert isinstance(capture, FileCapture)  # as all readers return it
    with closing(capture), console() as progress:
        done = write_masks(capture, folder, progress, clean_plate, find_sam2(), find_people())
    shares = ", ".join(f"{name} {share:.1%}" for name, share in done.shares.items())
    say(
        f"{folder}: masks of {len(done.shares)} cameras and {counted(capture.frames, 'frame')}, {capture.width} pixels wide"
    )
    say(f"  the subject covers {shares}")
    for note in done.notes:
        say(f"  {note}")


def is_complete(folder: Path) -> bool:
    """Return True if a folder has all masks of `make_masks`."""
    from splatreel.capture.masks import read_mask_record

    return bool((read_mask_record(folder) or {}).get("complete"))
