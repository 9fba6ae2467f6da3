"""`splatreel export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from splatreel.cli.options import AXES, ReelAddress, megabytes, parse_frames, reel_folder
from splatreel.cli.printing import say
from splatreel.errors import UsageError
from splatreel.scene.atomic import sweep

if TYPE_CHECKING:
    from splatreel.play.timeline import Timeline

WIDEST = 8192
"""Largest side of a film in pixels, about what H.264 allows."""
UP_OF_FORMAT = {".ply": "-y", ".spz": "y", ".glb": "y"}
"""Axis that points up in the files of each format."""
FORMATS = tuple(UP_OF_FORMAT)


def export(
    reel: ReelAddress,
    /,
    out: Path,
    frame: int | None = None,
    frames: str | None = None,
    rendition: str | None = None,
    width: int | None = None,
    path: Path | None = None,
    format: Literal["ply", "spz", "glb"] = "ply",
    up: Literal["x", "-x", "y", "-y", "z", "-z", "capture"] | None = None,
    max_memory: int | None = None,
) -> None:
    """Export a reel as one page that plays anywhere, as a film, or as PLY, SPZ or glTF files for other programs.

    Args:
        reel: Folder of the reel, or its URL: http(s), s3://BUCKET/REEL and the like (needs splatreel[cloud]).
        out: F.html for one page with player and reel; F.ply, F.spz or F.glb for one frame; a folder for one file per frame; F.mp4 for a
            film through the capture's cameras, with the reel's sound.
        frame: Frame to export, counted from 0; for one file.
        frames: Frames A to B - 1, as A:B; by default all. For a folder or a film.
        rendition: Rendition to export, for a reel that has several; by default the best.
        width: Width of the film in pixels; by default that of the reel's own camera.
        path: Camera path of the film, a JSON file that the player saved; by default through the capture's cameras.
        format: Format of the files in a folder: ply as 3DGS writes it, spz (small, 8 bits), glb (glTF with KHR_gaussian_splatting).
        up: Axis of the exported Gaussians that points up, or capture for the axes of the capture; by default that of the format, which
            is -y for PLY, as in 3DGS, and y for SPZ and glTF.
        max_memory: Megabytes that decoding a file may take; by default what a correct file of its length needs.
    """
    if out.suffix not in (*FORMATS, ".html", ".mp4", ""):
        raise UsageError(
            f"--out {out}: {out.suffix} is not an export format. Name a .ply, .spz or .glb file, an .mp4 film, an .html "
            "page or a folder."
        )
    if out.suffix == ".html":
        if any(value is not None for value in (frame, frames, width, path, up)):
            raise UsageError("A page holds the whole reel. Leave out --frame, --frames, --width, --path and --up.")
        _write_page(reel, out, rendition)
        return
    from splatreel.play.timeline import open_reel

    source = open_reel(reel_folder(reel), rendition, megabytes(max_memory))
    start, total = source.manifest.first_frame, source.manifest.frames
    if path is not None and (out.suffix != ".mp4" or frames is not None):
        raise UsageError("--path is for films (--out F.mp4), and holds the times that they show: leave out --frames.")
    if up is not None and out.suffix == ".mp4":
        raise UsageError("--up is for files of Gaussians. Leave it out for a film.")
    if (out.suffix in FORMATS) != (frame is not None):
        raise UsageError("One file takes --frame N; a folder of them, or a film (.mp4), takes --frames A:B or nothing.")
    first, end = (frame, frame + 1) if frame is not None else parse_frames(frames) or (start, total)
    if not start <= first < end <= total:
        wrong = f"frame {frame}" if frame is not None else f"frame {first if first < start else end - 1}"
        raise UsageError(f"{reel}: there is no {wrong}; choose {start} to {total - 1}.")
    place = out.parent if out.suffix else out
    place.mkdir(parents=True, exist_ok=True)
    sweep(place, out.name if out.suffix else "")
    if out.suffix in FORMATS:
        count = _write_frame(source, first, out, up)
        say(f"{out}: {count:,} Gaussians of frame {first}")
        _say_origin(source, out.suffix)
    elif out.suffix == ".mp4":
        _write_film(source, first, end, out, width, path)
    else:
        for index in range(first, end):
            _write_frame(source, index, out / f"{index:06}.{format}", up)
        say(f"{out}: {end - first} {format.upper()} files, frames {first} to {end - 1}")
        _say_origin(source, f".{format}")


def _say_origin(source: Timeline, suffix: str) -> None:
    """Report that SPZ files, which store small coordinates only, lack the reel's origin."""
    origin = source.manifest.origin
    if origin.any() and suffix == ".spz":
        say(
            f"Positions are relative to {', '.join(f'{v:.10g}' for v in origin)}, which SPZ cannot hold. PLY and glTF can."
        )


def _write_page(reel: str, out: Path, rendition: str | None) -> None:
    from splatreel.play.standalone import write_standalone

    sweep(out.parent, out.name)
    size = write_standalone(out, reel_folder(reel), rendition)
    say(f"{out}: player and reel, {size / 1e6:.2f} MB; open it in any browser")


def _write_frame(source: Timeline, frame: int, path: Path, up: str | None) -> int:
    """Write the Gaussians of a frame, rotated so that up is up in the format or as asked. Return their number."""
    import numpy as np

    from splatreel.scene import rotations
    from splatreel.scene.gltf import write_glb
    from splatreel.scene.ply import write_ply
    from splatreel.scene.spz import write_spz
    from splatreel.scene.turning import turn_between, turned

    gaussians, manifest = source.at(frame / source.fps), source.manifest
    end = manifest.up if up == "capture" else np.array(AXES[up or UP_OF_FORMAT[path.suffix]])
    turn, origin = turn_between(manifest.up, end), manifest.origin if manifest.origin.any() else None
    if path.suffix == ".glb":
        write_glb(path, gaussians, turn, origin)
    elif path.suffix == ".spz":
        write_spz(path, turned(gaussians, turn), manifest.antialias)
    else:
        moved = None if origin is None else rotations.to_matrix(turn) @ np.asarray(origin, np.float64)
        write_ply(path, turned(gaussians, turn), moved)
    return len(gaussians)


def _write_film(source: Timeline, first: int, end: int, out: Path, width: int | None, path: Path | None) -> None:
    from splatreel.play.camera_path import read_path
    from splatreel.play.film import film_along_path, film_through_cameras, write_film
    from splatreel.progress import console

    start = source.manifest.camera
    if width is not None:
        start = start.resized(max(width, 1), max(round(start.height * width / start.width), 1))
    if not (16 <= start.width <= WIDEST and 16 <= start.height <= WIDEST):
        asked = f"--width {width}" if width is not None else f"{start.width} x {start.height} pixels"
        raise UsageError(f"{asked}: films are 16 to {WIDEST} pixels wide and high. Choose another --width.")
    if path is None:
        shots = film_through_cameras(start, source.manifest.cameras, end - first, source.fps, first)
    else:
        shots = film_along_path(read_path(path), start, source.fps)
    progress = console()
    try:
        progress.stage("drawing the film", len(shots))
        write_film(out, source, shots, progress.update)
    finally:
        progress.close()
    say(f"{out}: {len(shots)} frames, {start.width} x {start.height}")
