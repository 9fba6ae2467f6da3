"""`splatreel export`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, arg

from splatreel.base.atomic import sweep
from splatreel.base.display import console
from splatreel.base.errors import UsageError
from splatreel.base.new_folder import created
from splatreel.cli.options import AXES, ReelAddress, check_out, megabytes, parse_frames, reel_folder
from splatreel.cli.printing import counted, say
from splatreel.formats.programs import FrameKind, Program, ProgramName

if TYPE_CHECKING:
    import numpy as np

    from splatreel.play.gaussian_export import GaussianExport
    from splatreel.play.timeline import Timeline

WIDEST = 8192
"""Largest side of a film in pixels, about what H.264 allows."""
FILMS = {".usdz": "y", ".usdc": "y", ".usda": "y", ".4dgs": "y", ".blend": "z"}
"""Suffixes of files of Gaussians that hold all frames, and the axis that points up in them."""
LARGE = 100_000_000
"""Bytes of an export above which its size is said before it is written."""


@dataclass(frozen=True)
class ChangeOptions:
    """Changes of exported Gaussians."""

    up: Literal["x", "-x", "y", "-y", "z", "-z", "capture"] | None = None
    """Axis of the exported Gaussians that points up, or capture for the axes of the capture; by default that of the format, which is -y
    for PLY, SOG and .splat, as in 3DGS, y for SPZ, glTF, USD and .4dgs, z for .blend."""
    crop: str | None = None
    """Volume to keep, in the coordinates of the reel, as `splatreel edit` takes it: box:x,y,z,X,Y,Z, sphere:x,y,z,RADIUS,
    cylinder:x,y,z,RADIUS,HEIGHT or capture."""

    @property
    def given(self) -> bool:
        """True if there is any change."""
        return self.up is not None or self.crop is not None


def export(
    reel: ReelAddress,
    /,
    out: Path,
    frame: int | None = None,
    at: float | None = None,
    frames: str | None = None,
    every: int = 1,
    rendition: str | None = None,
    width: int | None = None,
    path: Path | None = None,
    format: FrameKind | None = None,
    program: Annotated[ProgramName | None, arg(name="for")] = None,
    equal_counts: bool = False,
    changes: OmitArgPrefixes[ChangeOptions] = ChangeOptions(),
    max_memory: int | None = None,
) -> None:
    """Export a reel as one page that plays anywhere, as a film, or as Gaussians: PLY, SOG, SPZ, glTF, USD and others.

    Args:
        reel: Folder of the reel, or its URL: http(s), s3://BUCKET/REEL and the like (needs splatreel[cloud]).
        out: F.html for one page with player and reel; F.ply, F.compressed.ply, F.splat, F.sog, F.spz or F.glb for one frame; a folder
            for one file per frame; F.usdz, F.usdc, F.usda or F.4dgs for all frames in one file, or F.blend for Blender; F.mp4 for a
            film through the capture's cameras, with the reel's sound.
        frame: Frame to export, counted from 0; for one file.
        at: Time to export in seconds, also between two frames; for one file.
        frames: Frames A to B - 1, as A:B; by default all. For a folder, a film, or a file of all frames.
        every: Export every Nth frame only. The files of a folder are then numbered from 0 without gaps.
        rendition: Rendition to export, for a reel that has several; by default the best.
        width: Width of the film in pixels; by default that of the reel's own camera.
        path: Camera path of the film or of the .blend file, a JSON file that the player saved; by default films pass the capture's
            cameras.
        format: Format of the files in a folder, by default ply as 3DGS writes it. compressed-ply, sog, spz (version 3), spz2 and spz4
            are small; splat has no view-dependent color; glb is glTF with KHR_gaussian_splatting. For one file, the version of .spz.
        program: Program that is to open the files: sets their format, version, precision, degree of view-dependent color and
            --equal-counts to what it reads. docs/exports.md lists what that is.
        equal_counts: Give all frames of a folder or a USD file the same number of Gaussians in the same order, for programs that
            interpolate between frames. Those that do not show have opacity 0.
        changes: Changes of exported Gaussians.
        max_memory: Megabytes that decoding a file may take; by default what a correct file of its length needs.
    """
    check_out("--out", out, reel_folder(reel))
    reader = _program(program)
    kind = _kind(out, format) if reader is None else _kind_for(reader, program or "", out, format)
    if out.suffix == ".html":
        options = (frame, at, frames, width, path, changes.up, changes.crop)
        _write_page(reel, out, rendition, any(value is not None for value in options) or every > 1 or equal_counts)
        return
    _check_options(out, kind, frames, path, equal_counts, changes, every)
    from splatreel.play.gaussian_export import GaussianExport
    from splatreel.play.timeline import open_reel
    from splatreel.scene.volumes import parse_volume

    source = open_reel(reel_folder(reel), rendition, megabytes(max_memory))
    crop = None if changes.crop is None else parse_volume("--crop", changes.crop, source.manifest)
    one = kind is not None and bool(out.suffix)
    times = _times(source, reel, one, frame, at, frames, every)
    with created(out.parent if out.suffix else out):
        sweep(out.parent if out.suffix else out, out.name if out.suffix else "")
        if out.suffix == ".mp4":
            _write_film(source, times, out, width, path)
            return
        equal_counts |= reader is not None and reader.equal_counts and not one
        film = GaussianExport(source, times, _up(changes.up, kind, out), crop, reader, equal_counts)
        film.check_content()
        if out.suffix == ".blend":
            _write_blend(film, out, every, path)
        elif kind is None:
            _write_gaussian_film(film, out, every)
        elif one:
            points = film.at(times[0])
            film.write(out, kind, points)
            say(f"{out}: {len(points):,} Gaussians {f'of frame {frame}' if frame is not None else f'at {at:g} s'}")
        else:
            _write_folder(film, out, kind, every)
    _say_losses(film, out, kind)


def _check_options(
    out: Path,
    kind: str | None,
    frames: str | None,
    path: Path | None,
    equal_counts: bool,
    changes: ChangeOptions,
    every: int,
) -> None:
    """Raise `UsageError` for options that do not fit the output."""
    if equal_counts and (out.suffix in (".4dgs", ".blend", ".mp4") or (kind is not None and out.suffix)):
        raise UsageError("--equal-counts is for a folder of files and for USD. Leave it out for other files.")
    if path is not None and out.suffix not in (".blend", ".mp4"):
        raise UsageError("--path is for films (--out F.mp4) and .blend files. Leave it out for other files.")
    if path is not None and out.suffix == ".mp4" and frames is not None:
        raise UsageError("--path holds the times that a film shows. Leave out --frames.")
    if (changes.given or every > 1) and out.suffix == ".mp4":
        raise UsageError("--up, --crop and --every are for files of Gaussians. Leave them out for a film.")
    if every < 1:
        raise UsageError(f"--every {every}: give a whole number of frames, 1 or more.")


def _kind(out: Path, format: FrameKind | None) -> str | None:
    """Return the format of files of one frame, or None for a file that holds all frames.

    Raises:
        UsageError: The name has no format, or another one than asked for.
    """
    from splatreel.formats.registry import FRAME_FORMATS, format_of

    known = format_of(out)
    if out.suffix and known is None and out.suffix not in (*FILMS, ".html", ".mp4"):
        raise UsageError(
            f"--out {out}: {out.suffix} is not an export format. Name a .ply, .compressed.ply, .splat, .sog, .spz or .glb file for one "
            "frame, a .usdz, .usdc, .usda, .4dgs or .blend file, an .mp4 film, an .html page or a folder."
        )
    if format is not None and out.suffix and not (known and out.name.endswith(FRAME_FORMATS[format].suffix)):
        raise UsageError(f"--format {format}: --out {out} has another suffix. Leave out --format, or name a folder.")
    return format or known or ("ply" if not out.suffix else None)


def _program(name: ProgramName | None) -> Program | None:
    from splatreel.formats.programs import PROGRAMS

    return None if name is None else PROGRAMS[name]


def _kind_for(program: Program, name: str, out: Path, format: FrameKind | None) -> str:
    """Return the format of files for a program.

    Raises:
        UsageError: The program does not read what was asked for.
    """
    from splatreel.formats.registry import FRAME_FORMATS

    suffixes = list(dict.fromkeys(FRAME_FORMATS[kind].suffix for kind in program.formats))
    fits = [kind for kind in program.formats if not out.suffix or out.name.endswith(FRAME_FORMATS[kind].suffix)]
    kind = max(fits, key=lambda fit: len(FRAME_FORMATS[fit].suffix), default=None)
    if kind is None:
        raise UsageError(
            f"--for {name}: {program.name} reads {', '.join(suffixes)}. Name such a file, or a folder, with --out."
        )
    if format is not None and format not in fits:
        raise UsageError(
            f"--for {name}: {program.name} reads {', '.join(program.formats)}. Leave out --format {format}."
        )
    return format or (kind if out.suffix else program.formats[0])


def _times(
    source: Timeline, reel: str, one: bool, frame: int | None, at: float | None, frames: str | None, every: int
) -> list[float]:
    """Return the times to export in seconds.

    Raises:
        UsageError: Options contradict each other, or the reel has no such time.
    """
    start, total = source.manifest.first_frame, source.manifest.frames
    single = frame is not None or at is not None
    if one and (not single or frames is not None or every > 1):
        raise UsageError("A file of one frame takes --frame N or --at SECONDS, and neither --frames nor --every.")
    if single and not one:
        raise UsageError(
            "--frame and --at are for a file of one frame, such as F.ply. Give --frames A:B, or nothing for all."
        )
    if frame is not None and at is not None:
        raise UsageError("--frame and --at name the same thing. Leave out one of them.")
    if at is not None:
        if not start / source.fps <= at <= total / source.fps:
            raise UsageError(
                f"--at {at:g}: {reel} lasts from {start / source.fps:g} to {total / source.fps:g} seconds."
            )
        return [at]
    first, end = (frame, frame + 1) if frame is not None else parse_frames(frames) or (start, total)
    if not start <= first < end <= total:
        wrong = f"frame {frame}" if frame is not None else f"frame {first if first < start else end - 1}"
        raise UsageError(f"{reel}: there is no {wrong}; choose {start} to {total - 1}.")
    return [index / source.fps for index in range(first, end, every)]


def _up(asked: str | None, kind: str | None, out: Path) -> np.ndarray | None:
    """Return the up direction of files of a kind, or of a film; None for that of the capture."""
    import numpy as np

    from splatreel.formats.registry import FRAME_FORMATS

    usual = FRAME_FORMATS[kind].up if kind else FILMS[out.suffix]
    return None if asked == "capture" else np.array(AXES[asked or usual], float)


def _span(source: Timeline, times: list[float], every: int) -> str:
    first, last = (round(time * source.fps) for time in (times[0], times[-1]))
    return f"frames {first} to {last}" + (f", every {every}" if every > 1 else "")


def _write_folder(film: GaussianExport, out: Path, kind: str, every: int) -> None:
    """Write a file for each frame."""
    from splatreel.formats.registry import FRAME_FORMATS

    times = list(film.seconds)
    first = round(times[0] * film.source.fps) if every == 1 else 0
    equal = ""
    for number, points in enumerate(film, first):
        file = out / f"{number:06}{FRAME_FORMATS[kind].suffix}"
        film.write(file, kind, points)
        if number == first:
            _say_size(out, file.stat().st_size * len(times), len(times), "a smaller format, such as --format spz")
        equal = f", {len(points):,} Gaussians in each" if film.equal_counts else ""
    say(f"{out}: {len(times)} {kind.upper()} files, {_span(film.source, times, every)}{equal}")


def _write_gaussian_film(film: GaussianExport, out: Path, every: int) -> None:
    """Write all frames into one file of Gaussians."""
    from splatreel.formats.fourdgs_writer import write_fourdgs
    from splatreel.formats.usd import estimate_bytes, write_usd

    times = list(film.seconds)
    if out.suffix != ".4dgs":
        _say_size(out, estimate_bytes(out, film), len(times), "a .4dgs file")
    write = write_fourdgs if out.suffix == ".4dgs" else write_usd
    write(out, film, film.source.fps / every)
    say(f"{out}: {counted(len(times), 'frame')}, {_span(film.source, times, every)}, {out.stat().st_size / 1e6:.2f} MB")


def _write_blend(film: GaussianExport, out: Path, every: int, path: Path | None) -> None:
    """Write all frames into a file of Blender."""
    from splatreel.play.blend_export import write_blend
    from splatreel.play.film import read_path

    times = list(film.seconds)
    made = write_blend(out, film, film.source.fps / every, None if path is None else read_path(path))
    say(
        f"{out}: {counted(len(times), 'frame')}, {_span(film.source, times, every)}, {out.stat().st_size / 1e6:.2f} MB; positions "
        f"within {made.error:.0e} of the extent by {counted(made.vectors, 'vector')}, colors and opacities within "
        f"{made.color_error:.3f}"
    )
    if made.lacks_sound:
        say("The sound is left out, since the module bpy cannot write it. The program blender in PATH can.")


def _say_size(out: Path, size: int, frames: int, smaller: str) -> None:
    """Say the size of a large export before it is written, and how to make it smaller."""
    if size >= LARGE:
        say(
            f"{out}: writing about {size / 1e6:,.0f} MB, {counted(frames, 'frame')}. Smaller: every second frame (--every 2), fewer "
            f"frames (--frames A:B), a part of the scene (--crop), or {smaller}."
        )


def _say_losses(film: GaussianExport, out: Path, kind: str | None) -> None:
    """Report what files lack of the reel: its origin, because they store small coordinates, and its mark of antialiasing."""
    from splatreel.formats.registry import FRAME_FORMATS

    if kind is None:
        suffix, origin, antialias = out.suffix, out.suffix not in (".4dgs", ".blend"), False
    else:
        format = FRAME_FORMATS[kind]
        suffix, origin, antialias = format.suffix, format.keeps_origin and film.keeps_origin, format.marks_antialias
    program, manifest = film.program, film.source.manifest
    whose = f"{suffix} files" if program is None else f"{suffix} files for {program.name}"
    if manifest.origin.any() and not origin:
        place = ", ".join(f"{v:.10g}" for v in manifest.origin)
        remedy = "PLY, glTF and USD can." if program is None else "Without --for, PLY files keep it."
        say(f"Positions are relative to {place}, which {whose} cannot hold. {remedy}")
    if manifest.antialias and not antialias and suffix != ".blend":
        say(
            f"The points were trained with antialiasing (Mip-Splatting), which {whose} cannot mark. Switch it on in the program that "
            "draws them, if it can."
        )


def _write_page(reel: str, out: Path, rendition: str | None, has_options: bool) -> None:
    """Write the player and the whole reel into one page. Options that select a part of a reel are refused."""
    if has_options:
        raise UsageError(
            "A page holds the whole reel. Leave out --frame, --at, --frames, --every, --width, --path, --up, --crop, --equal-counts."
        )
    from splatreel.play.player_page import write_standalone

    sweep(out.parent, out.name)
    size = write_standalone(out, reel_folder(reel), rendition)
    say(f"{out}: player and reel, {size / 1e6:.2f} MB; open it in any browser")


def _write_film(source: Timeline, times: list[float], out: Path, width: int | None, path: Path | None) -> None:
    from splatreel.play.film import film_along_path, film_through_cameras, read_path, write_film

    start = source.manifest.camera
    if width is not None:
        start = start.resized(max(width, 1), max(round(start.height * width / start.width), 1))
    if not (16 <= start.width <= WIDEST and 16 <= start.height <= WIDEST):
        asked = f"--width {width}" if width is not None else f"{start.width} x {start.height} pixels"
        raise UsageError(f"{asked}: films are 16 to {WIDEST} pixels wide and high. Choose another --width.")
    if path is None:
        first = round(times[0] * source.fps)
        shots = film_through_cameras(start, source.manifest.cameras, len(times), source.fps, first)
    else:
        shots = film_along_path(read_path(path), start, source.fps)
    with console() as progress:
        progress.stage("drawing the film", len(shots))
        write_film(out, source, shots, progress.update)
    say(f"{out}: {len(shots)} frames, {start.width} x {start.height}")
