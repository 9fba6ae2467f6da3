"""The capture that a reel was made from, opened at the frames that the reel shows and with the cameras that were held out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from splatreel.base.errors import UsageError
from splatreel.capture.base import Capture
from splatreel.capture.masks import MADE_MASKS, read_mask_record
from splatreel.capture.opening import CaptureSource
from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.run.run_folder import read_run_source
from splatreel.scene.reel_source import ReelSource
from splatreel.storage.address import is_url


def work_of(reel: str | Path, manifest: Manifest) -> Path | None:
    """Return the folder of the checkpoints that a reel was written from.

    None if the folder is not beside the reel, or if `edit` changed the reel.
    """
    if is_url(str(reel)):
        return None
    reel = Path(reel)
    work = reel.parent / "work"
    is_of_run = reel.name == "reel" if manifest.source is None else not manifest.source.edited
    return work if is_of_run and work.is_dir() else None


def _source_of(reel: str | Path, manifest: Manifest) -> ReelSource | None:
    """Return the frames and cameras that a reel was made from, by its manifest or by its run; None if unknown."""
    if manifest.source is not None:
        return manifest.source
    work = work_of(reel, manifest)
    return None if work is None else read_run_source(work)


def open_reel_capture(
    reel: str | Path,
    capture: str | Path,
    *,
    width: int | None = None,
    scale: float | None = None,
    frames: tuple[int, int] | None = None,
    held_out: Sequence[str] | None = None,
    left_out: Sequence[str] = (),
    masks: str | Path | None = None,
    names: Sequence[str] | None = None,
) -> tuple[Capture, list[int]]:
    """Open the capture that a reel was made from.

    Args:
        reel: Folder or URL of the reel.
        capture: Folder or address of the capture.
        width: Width of the images in pixels; None and no scale means that of the reel's cameras.
        scale: Size of the images, as a share of the capture's, instead of the width.
        frames: First frame and end (exclusive) of the capture to compare with. None means all that the reel shows. If it is
            unknown which these are, `frames` must be given, and the reel begins with the first of them.
        held_out: Names of held-out cameras; None means those of the reel's run.
        left_out: Names of cameras that are not read, besides those that were not read for the reel.
        masks: Folder of masks. None means those that `reconstruct --masks auto` made, if the reel shows their subject.
        names: Names of the cameras to compare with; None means the held-out ones. Only these need masks. Cameras that were not read
            for the reel may be among them.

    Returns:
        The capture, whose first frame is frame 0 of the reel, and the frames of the reel to compare.

    Raises:
        UsageError: The reel shows a part of the scene only and there are no masks, its frames or held-out cameras are
            unknown and not given, or the reel does not show the given frames.
        CaptureError: The capture cannot be used.
    """
    manifest = ReelReader(reel).manifest
    source = _source_of(reel, manifest)
    if masks is None and source is not None and source.part == "masks":
        masks = _made_masks(reel)
    if masks is None and source is not None and source.part:
        raise UsageError(
            f"{reel}: was {_cause(source)}, so whole images cannot be compared. `evaluate --masks` compares a part."
        )
    begin, chosen = _span(reel, manifest, source, frames)
    request: dict[str, Any] = {"frames": begin, "held_out": list(held_out) if held_out is not None else None}
    if held_out is None and source is not None and source.held_out:
        request["held_out"] = list(source.held_out)
    if width is None and scale is None:
        width = manifest.camera.width
    if masks is not None:
        masked = names if names is not None else request["held_out"]
        request |= {"masks": masks, "background": manifest.background, "masked": masked}
    known_unread = set(source.left_out if source else ()) - set(names or ())
    if unread := sorted({*left_out, *known_unread}):
        request["leave_out"] = unread
    opened = CaptureSource(capture, {"width": width, "scale": scale, **request})()
    trained = {camera.name for camera in manifest.cameras}
    if source is None and held_out is None and names is None and trained.issuperset(opened.held_out):
        opened.close()
        others = [camera.name for camera in opened.cameras if camera.name not in trained]
        raise UsageError(
            f"{reel}: which cameras were held out is not known, and it was trained on {', '.join(opened.held_out) or 'others'}. "
            f"Name cameras with --cameras; it was not trained on {', '.join(others) or 'any other'}."
        )
    return opened, chosen


def _made_masks(reel: str | Path) -> Path | None:
    """Return the folder of the masks that a run made, which is beside its reel, if it exists."""
    if is_url(str(reel)):
        return None
    folder = Path(reel).parent / MADE_MASKS
    return folder if read_mask_record(folder) is not None else None


def _span(
    reel: str | Path, manifest: Manifest, source: ReelSource | None, frames: tuple[int, int] | None
) -> tuple[tuple[int, int] | None, list[int]]:
    """Return the frames of the capture to open, and the frames of the reel to compare."""
    start = None if source is None else source.frame
    shown = range(manifest.first_frame, manifest.frames)
    if start is not None:
        first, end = frames or (start + shown.start, start + shown.stop)
        if not start + shown.start <= first < end <= start + shown.stop:
            raise UsageError(
                f"{reel}: shows frames {start + shown.start}:{start + shown.stop} of its capture, and --frames {first}:{end} "
                "are not among these. Choose some of them, or leave out --frames."
            )
        return (start, start + shown.stop), list(range(first - start, end - start))
    if frames is None:
        if source is not None and source.edited:
            raise UsageError(
                f"{reel}: which frames of the capture it shows is not known: it was reversed, joined or retimed. Evaluate it before "
                f"that edit. If it shows {len(shown)} frames of the capture in their order, give them: --frames A:B."
            )
        raise UsageError(
            f"{reel}: which frames of the capture it shows is not known: it was imported, or an older version wrote it. "
            f"Give its {len(shown)} frames of the capture, in their order: --frames A:B."
        )
    return frames, list(range(shown.start, min(shown.stop, frames[1] - frames[0])))


def _cause(source: ReelSource) -> str:
    return "cut out by `edit crop=`" if source.part == "crop" else f"reconstructed with --{source.part}"
