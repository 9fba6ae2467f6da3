"""`splatreel import`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from splatreel.base.display import console
from splatreel.base.errors import UsageError
from splatreel.base.threads import use as use_threads
from splatreel.cli.options import AXES, ReelTexts, check_out, new_reel
from splatreel.cli.options import megabytes as memory_limit
from splatreel.cli.printing import already_complete, counted, playable, say
from splatreel.config import COARSENESS, EncodeConfig, Quality, Rate

if TYPE_CHECKING:
    import numpy as np

    from splatreel.codec.header import ReelHeader
    from splatreel.codec.presentation import Limits
    from splatreel.importing.comparison import Comparison
    from splatreel.importing.edits import Edit
    from splatreel.importing.frames import Frames


LONELY = 2
"""Mean frames per group below which points are not followed."""


@dataclass(frozen=True)
class ChangeOptions:
    """Changes of all frames."""

    scale: float = 1.0
    """Factor of all lengths, such as 0.001 from millimeters to meters."""
    crop: str | None = None
    """Box to keep, as x,y,z,X,Y,Z: its low and its high corner in the coordinates of the files."""
    min_opacity: float = 0.0
    """Leave out points of a lower opacity, 0 to 1."""

    def edit(self) -> Edit:
        """Return the changes, without a shifted origin.

        Raises:
            UsageError: A value is out of its range.
        """
        if not 1e-9 <= self.scale <= 1e9:
            raise UsageError(f"--scale {self.scale:g}: give a factor of lengths from 1e-9 to 1e9.")
        if not 0 <= self.min_opacity <= 1:
            raise UsageError(f"--min-opacity {self.min_opacity:g}: give an opacity from 0 to 1.")
        import numpy as np

        from splatreel.importing.edits import Edit

        return Edit(np.zeros(3), self.scale, _parse_crop(self.crop), self.min_opacity)


def import_frames(
    frames: Annotated[Positional[Path], arg(metavar="FRAMES")],
    /,
    out: Path,
    fps: float | None = None,
    length: int | None = None,
    cameras: Path | None = None,
    up: str | None = None,
    changes: OmitArgPrefixes[ChangeOptions] = ChangeOptions(),
    rate: Rate | None = None,
    title: str | None = None,
    antialiased: bool = False,
    gaps: Literal["refuse", "hold"] = "refuse",
    fit: Quality | None = None,
    threads: int | None = None,
    max_memory: int | None = None,
) -> None:
    """Make a reel of Gaussians that another program trained: numbered PLY, SPZ, SOG or .splat files, or other formats.

    Gaussians that stay the same from frame to frame are stored once. They are recognized if all files hold the same points in the same
    order, or at least the very same points where nothing moves. At the end the reel is compared with the files.

    Args:
        frames: Folder with one file per frame (frame0000.ply, frame0001.ply, ...), one such file, a zip archive of them, or the
            params.npz of Dynamic 3D Gaussians. docs/inputs.md lists all formats.
        out: Folder of the new reel.
        fps: Frames per second; by default as the sequence states it, otherwise 30.
        length: Number of frames of a SpacetimeGaussians model; by default as the cfg_args of its training states.
        cameras: Cameras that the film was made from: cameras.json as 3DGS writes it, a calibration file, or the capture. The reel
            then starts at one of them, keeps viewers near them, and spends its bytes on what they see. By default a ring of cameras
            around everything is assumed.
        up: Axis that points up: x, -x, y, -y, z or -z; by default that of the cameras, or -y without cameras.
        changes: Changes of all frames.
        rate: high has hardly any loss; medium and low are smaller. By default high, and medium with --fit.
        title: Title of the reel in the player.
        antialiased: The points were trained to be drawn like Mip-Splatting does, blurred by 0.1 square pixels and fainter. PLY, SPZ and
            SOG files that are marked so need no option.
        gaps: Handling of missing file numbers. refuse: make nothing; hold: show the frame before for as long.
        fit: For frames that were trained independently, so that no point can be followed: fit new points that move to images of the
            frames, as reconstruct does with this quality. The reel is far smaller, but not exact, and takes as long as a
            reconstruction. OUT/reel gets the reel, OUT/work the checkpoints, from which the same command continues.
        threads: Number of threads; by default one per core.
        max_memory: Megabytes that reading a file may take; by default in proportion to its length.
    """
    _check_options(fps, length, up, cameras if fit else None)
    check_out("--out", out, frames, below=False)
    edit, words = changes.edit(), ReelTexts(title=title).given()
    use_threads(threads)
    from splatreel.codec.writer import ReelWriter
    from splatreel.importing.edits import edited, first_points
    from splatreel.importing.frames import open_frames
    from splatreel.importing.reel import write_reel
    from splatreel.importing.viewpoints import dome
    from splatreel.play.presentation_writer import PresentationWriter

    film, edit = edited(open_frames(frames, gaps, fps, length, memory_limit(max_memory)), edit)
    header, limits = _describe(film, edit, cameras, up, fps, antialiased)
    present = PresentationWriter(words, {"title": _name_as_title(frames)})
    existed = False
    with console() as progress:
        if fit is None:
            with new_reel(out) as made:
                writer = ReelWriter(made.path, header, config=EncodeConfig(coarseness=COARSENESS[rate or "high"]))
                found = write_reel(film, writer, made.checked(progress, "layers", "groups"), limits, present)
            reel, existed = out, made.existing is not None
        else:
            from splatreel.importing.fit import fit_config, fit_reel

            seen_by = dome(first_points(film), header.up) if cameras is None else list(header.cameras)
            config = fit_config(fit, rate or "medium")
            reel, found = fit_reel(film, seen_by, header, out, config, progress, present)
    if existed:
        say(already_complete(out))
    _say_result(film, found, reel)
    _say_changes(film, edit, fps)
    if fit is None:
        _say_doubts(found, rate or "high", len(film), reel)
    if cameras is None:
        _say_ring(up)
    say(playable(reel))


def _name_as_title(frames: Path) -> str:
    """Return the name of a file or folder as a title. Bytes that are not UTF-8 are replaced, and a long name is cut."""
    from splatreel.codec.presentation import MAX_TEXT

    return os.fsencode(frames.name).decode("utf-8", "replace")[: MAX_TEXT["title"]]


def _describe(
    film: Frames, edit: Edit, cameras: Path | None, up: str | None, fps: float | None, antialiased: bool
) -> tuple[ReelHeader, Limits | None]:
    """Return the header of the reel, and the limits of its views, from the options."""
    import numpy as np

    from splatreel.importing.comparison import check_seen
    from splatreel.importing.edits import first_points
    from splatreel.importing.reel import header_of
    from splatreel.importing.viewpoints import read_cameras

    views = cameras and [edit.camera(camera) for camera in read_cameras(cameras, edit.origin)]
    axis = None if up is None else np.array(AXES[up], float)
    rate = fps or film.fps or 30.0
    header, limits = header_of(
        first_points(film), views, axis, rate, antialiased or film.antialias, edit.scale * edit.origin
    )
    whose = f"the cameras of {cameras}" if cameras else "the cameras"
    check_seen(film, list(header.cameras), header.near, header.antialias, whose)
    return header, limits


def _say_result(film: Frames, found: Comparison, reel: Path) -> None:
    from splatreel.evaluation.report import compared_size, megabytes
    from splatreel.play.timeline import open_reel

    size = sum(file.bytes for file in open_reel(reel).manifest.files)
    say(
        f"{counted(len(film), 'frame')} in {megabytes(size)}, {compared_size(size, film.size)} the {megabytes(film.size)} of "
        f"{film.path}. Its images have {found.psnr:.1f} dB PSNR against those of the files (mean of {found.images})."
    )


def _say_unfollowed(frames: int, reel: Path) -> None:
    """Suggest a fit if hardly any frame shares points with the next. A frame without points has none to share."""
    from splatreel.play.timeline import open_reel

    made = open_reel(reel)
    if 1 < frames < LONELY * len(made.manifest.groups):
        shows = (len(made.at(frame / made.fps)) > 0 for frame in range(frames))
        if not any(one and next_one for one, next_one in pairwise(shows)):
            return
        say(
            "No point could be followed from frame to frame, so each frame is stored alone. If the frames were trained "
            "independently, --fit standard makes a far smaller reel."
        )


def _say_ring(up: str | None) -> None:
    say(
        f"A ring of cameras was assumed, with {up or '-y'} up. If that is wrong, name the cameras of the film (--cameras), "
        "or another --up."
    )


def _say_changes(film: Frames, edit: Edit, fps: float | None) -> None:
    """Report what was converted or dropped, and where the origin and the frame rate come from."""
    for line in film.remarks.lines():
        say(line)
    if film.antialias:
        say("The files mark their points as trained with antialiasing. The reel draws them so.")
    if edit.origin.any():
        place = ", ".join(f"{value:.10g}" for value in edit.origin)
        say(
            f"Positions are stored relative to {place}, because 32-bit numbers are too coarse there. Exports add it again."
        )
    if fps is None and film.fps:
        say(
            f"The sequence has {film.fps:.5g} frames per second, by its names or its own time. --fps sets another rate."
        )


def _check_options(fps: float | None, length: int | None, up: str | None, fitted: Path | None) -> None:
    """Check the ranges of options, and that cameras to fit images of are not given another up axis.

    Raises:
        UsageError: A value is out of its range, or excludes another one.
    """
    if fps is not None and not 0 < fps <= 1000:
        raise UsageError(f"--fps {fps:g}: give frames a second, more than 0 and at most 1000.")
    if length is not None and not 1 <= length <= 1_000_000:
        raise UsageError(f"--length {length}: give a number of frames, 1 to 1,000,000.")
    if up is not None and up not in AXES:
        raise UsageError(f"--up {up}: choose {', '.join(AXES)}.")
    if fitted and up:
        raise UsageError("--fit takes the up axis from --cameras. Leave out --up.")


def _parse_crop(text: str | None) -> np.ndarray | None:
    """Return `x,y,z,X,Y,Z` as the corners [2, 3] of a box.

    Raises:
        UsageError: The text is something else, or the box is empty.
    """
    if text is None:
        return None
    import numpy as np

    try:
        corners = np.array([float(word) for word in text.split(",")]).reshape(2, 3)
    except ValueError as error:
        raise UsageError(f"--crop {text!r:.80}: write six numbers, x,y,z,X,Y,Z, as --crop=-1,-1,0,1,1,2.") from error
    if not (corners[0] < corners[1]).all():
        raise UsageError(f"--crop {text!r:.80}: its low corner is not below its high corner.")
    return corners


def _say_doubts(found: Comparison, rate: Rate, frames: int, reel: Path) -> None:
    """Name cameras that see nothing, and the cause of a visible loss or of many bytes."""
    from splatreel.importing.comparison import CLOSE

    if found.blind:
        say(f"Cameras that see nothing of the film: {', '.join(found.blind)}.")
    if found.psnr < CLOSE:
        rated = f"the rate is {rate}, and --rate high loses less." if rate != "high" else "it was lost in encoding."
        say(f"Warning: below {CLOSE:.0f} dB the reel differs visibly from the film. The cause: {found.cause or rated}")
    _say_unfollowed(frames, reel)
