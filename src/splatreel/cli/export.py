"""`splatreel export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from splatreel.cli.options import ReelAddress, megabytes, parse_frames, reel_folder
from splatreel.cli.output import say
from splatreel.errors import UsageError
from splatreel.scene.atomic import sweep

if TYPE_CHECKING:
    from splatreel.play.timeline import Timeline

WIDEST = 8192
"""Pixels of a film's side, about what H.264 allows."""
FORMATS = (".ply", ".spz", ".glb")


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
    max_memory: int | None = None,
) -> None:
    """Write a reel for others: as one page that plays anywhere, as a film, or frames as PLY, SPZ or glTF files for other programs.

    Args:
        reel: Folder of the reel, or its URL: http(s), s3://BUCKET/REEL and the like (needs splatreel[cloud]).
        out: F.html for one page with player and reel; F.ply, F.spz or F.glb for one frame, a folder for a file a frame; F.mp4 for a
            film through the capture's cameras, with the reel's sound.
        frame: Which frame, counted from 0; for one file.
        frames: A:B, frames A to B - 1; by default all. For a folder or a film.
        rendition: Which one, of a reel that has several; by default the best.
        width: Width of the film in pixels; by default that of the reel's own camera.
        path: Camera path of the film, a JSON file that the player saved; by default through the capture's cameras.
        format: Of the files in a folder: ply as 3DGS writes it, spz (small, 8 bits), glb (glTF with KHR_gaussian_splatting).
        max_memory: Megabytes that decoding a file may take; by default what one of its length honestly needs.
    """
    if out.suffix not in (*FORMATS, ".html", ".mp4", ""):
        raise UsageError(
            f"--out {out}: {out.suffix} is no format that is written. Name a .ply, .spz or .glb file, an .mp4 film, an .html "
            "page or a folder."
        )
    if out.suffix == ".html":
        if any(value is not None for value in (frame, frames, width, path)):
            raise UsageError("A page holds the whole reel. Leave out --frame, --frames, --width and --path.")
        _write_page(reel, out, rendition)
        return
    from splatreel.play.timeline import open_reel

    source = open_reel(reel_folder(reel), rendition, megabytes(max_memory))
    start, total = source.manifest.first_frame, source.manifest.frames
    if path is not None and (out.suffix != ".mp4" or frames is not None):
        raise UsageError(
            "--path is for films (--out F.mp4), and says itself which times of the reel they show: leave out --frames."
        )
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
        count = _write_frame(source, first, out)
        say(f"{out}: {count:,} Gaussians of frame {first}")
    elif out.suffix == ".mp4":
        _write_film(source, first, end, out, width, path)
    else:
        for index in range(first, end):
            _write_frame(source, index, out / f"{index:06}.{format}")
        say(f"{out}: {end - first} {format.upper()} files, frames {first} to {end - 1}")


def _write_page(reel: str, out: Path, rendition: str | None) -> None:
    from splatreel.play.standalone import write_standalone

    sweep(out.parent, out.name)
    size = write_standalone(out, reel_folder(reel), rendition)
    say(f"{out}: player and reel, {size / 1e6:.2f} MB; open it in any browser")


def _write_frame(source: Timeline, frame: int, path: Path) -> int:
    from splatreel.scene.gltf import write_glb
    from splatreel.scene.ply import write_ply
    from splatreel.scene.spz import write_spz

    gaussians = source.at(frame / source.fps)
    if path.suffix == ".glb":
        write_glb(path, gaussians, source.manifest.up)
    elif path.suffix == ".spz":
        write_spz(path, gaussians, source.manifest.antialias)
    else:
        write_ply(path, gaussians)
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
