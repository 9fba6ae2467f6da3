"""Compare a reel of an imported sequence with other formats: bytes per frame and PSNR against the files.

    python benchmarks/importing.py FILM --cameras cameras.json --out OUT
    python benchmarks/importing.py CAPTURE --train 160 --frames 0:12 --fit draft --out OUT

FILM is a folder of numbered PLY files. --train makes one: each frame of a capture is trained on its own. SPZ and SOG
files are written and read again by splat-transform (npm @playcanvas/splat-transform, --splat-transform names its
command), a .4dgs file by the package fourdgs. Formats without time take the bytes of the compared frames, times the
number of frames. The last column is what the reel takes at the PSNR of the format, interpolated between its rates.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from record import record
from splatreel.base.progress import Silent
from splatreel.capture.opening import open_capture
from splatreel.cli.import_frames import import_frames
from splatreel.cli.options import parse_frames
from splatreel.codec.writer import ReelWriter
from splatreel.config import COARSENESS, EncodeConfig, Quality, preset
from splatreel.config.settings import changed
from splatreel.evaluation.metrics import psnr
from splatreel.formats.ply import read_ply, write_ply
from splatreel.importing.edits import first_points
from splatreel.importing.frames import Frames, open_frames
from splatreel.importing.reel import header_of, write_reel
from splatreel.importing.viewpoints import read_cameras
from splatreel.method.train.single_frame import reconstruct_single_frame
from splatreel.play.timeline import draw_on_cpu, open_reel
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

COARSER = (6.0, 12.0)
"""Coarseness of further reels, whose PSNR may be that of formats with a lower one than the rate low."""
SIDE, NEAR = 768, 0.2
"""Pixels along the longer side of compared images at most, and the near plane of 3DGS in world units."""


class Judge:
    """Images of some frames of the film, seen by its cameras in turn."""

    def __init__(self, film: Frames, cameras: list[Camera], images: int, antialias: bool) -> None:
        self.antialias = antialias
        self.frames = np.unique(np.linspace(0, len(film) - 1, images).round().astype(int)).tolist()
        views = [cameras[i * len(cameras) // len(self.frames)].at_most(SIDE) for i in range(len(self.frames))]
        self._pairs = [
            (frame, view, self._draw(film.read(frame), view)) for frame, view in zip(self.frames, views, strict=True)
        ]

    def psnr(self, read: Callable[[int], Gaussians]) -> float:
        """Return the mean PSNR of the images of what `read` returns for a frame."""
        return self.psnr_of_images(lambda frame, view: self._draw(read(frame), view))

    def psnr_of_images(self, draw: Callable[[int, Camera], np.ndarray]) -> float:
        """Return the mean PSNR of the images that `draw` returns for a frame and a view."""
        return float(np.mean([psnr(np.clip(draw(frame, view), 0, 1), truth) for frame, view, truth in self._pairs]))

    def _draw(self, points: Gaussians, view: Camera) -> np.ndarray:
        return np.clip(draw_on_cpu(points, view, NEAR, self.antialias, (0.0, 0.0, 0.0)), 0, 1)


def measure_reel(given: argparse.Namespace, film: Frames, judge: Judge, coarseness: float) -> tuple[float, float]:
    """Import the film and return bytes per frame and PSNR."""
    out = given.out / f"reel-{coarseness:g}"
    shutil.rmtree(out, ignore_errors=True)
    header, limits = header_of(first_points(film), read_cameras(given.cameras), None, 30.0, given.antialiased)
    writer = ReelWriter(out, header, config=EncodeConfig(coarseness=coarseness))
    write_reel(film, writer, Silent(), limits)
    reel = open_reel(out)
    size = sum(entry.bytes for entry in reel.manifest.files)
    return size / len(film), judge.psnr(lambda frame: reel.at(frame / reel.fps))


def measure_files(given: argparse.Namespace, film: Frames, judge: Judge, suffix: str) -> tuple[float, float]:
    """Convert the compared frames with splat-transform and return bytes per frame and PSNR."""
    sizes, files = [], {}
    for frame in judge.frames:
        source, packed, back = (given.out / f"{frame}{end}" for end in (".ply", suffix, ".back.ply"))
        write_ply(source, film.read(frame))
        for arguments in ((source, packed), (packed, back)):
            command = [*shlex.split(given.splat_transform), "-q", "-w", "-g", "cpu", *map(str, arguments)]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        sizes.append(packed.stat().st_size)
        files[frame] = back
    return float(np.mean(sizes)), judge.psnr(lambda frame: read_ply(files[frame]))


def measure_fourdgs(given: argparse.Namespace, film: Frames, judge: Judge, profile: str) -> tuple[float, float]:
    """Convert the film with fourdgs and return bytes per frame and PSNR."""
    file = given.out / f"{profile}.4dgs"
    command = [sys.executable, "-m", "fourdgs.cli", "convert", str(given.film), "-o", str(file), "--fps", "30"]
    subprocess.run([*command, "--profile", profile], check=True, stdout=subprocess.DEVNULL)
    scene = open_frames(file, fps=30)
    return file.stat().st_size / len(film), judge.psnr(lambda frame: scene.read(min(frame, len(scene) - 1)))


def measure_fit(given: argparse.Namespace, film: Frames, judge: Judge, quality: Quality) -> tuple[float, float]:
    """Import the film with --fit and return bytes per frame and PSNR."""
    out = given.out / f"fit-{quality}"
    shutil.rmtree(out, ignore_errors=True)
    import_frames(given.film, out=out, cameras=given.cameras, antialiased=given.antialiased, fit=quality)  # pyright: ignore[reportArgumentType]
    reel = open_reel(out / "reel")
    size = sum(entry.bytes for entry in reel.manifest.files)
    return size / len(film), judge.psnr_of_images(lambda frame, view: reel.render(reel.at(frame / reel.fps), view))


def train_film(given: argparse.Namespace) -> None:
    """Train each frame of a capture on its own, with its own seed, and write the film and its cameras."""
    frames = parse_frames(given.frames)
    capture = open_capture(given.film, width=given.train, frames=frames)
    given.film, given.cameras, given.antialiased = given.out / "film", given.out / "cameras.json", True
    given.film.mkdir(exist_ok=True)
    cameras = capture.training_cameras
    given.cameras.write_text(json.dumps([_entry(camera, index) for index, camera in enumerate(cameras)]))
    for frame in range(capture.frames):
        images = capture.read(frame, 1, [camera.name for camera in cameras])[0]
        config = changed(preset("draft"), {"seed": frame, "background": False})
        points, _ = reconstruct_single_frame(cameras, images, config)
        write_ply(given.film / f"frame{frame:04}.ply", points)


def _entry(camera: Camera, index: int) -> dict[str, Any]:
    """Return a camera as 3DGS writes it into cameras.json."""
    return {
        "id": index,
        "img_name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "position": camera.center.tolist(),
        "rotation": camera.viewmat[:3, :3].T.tolist(),
        "fx": float(camera.K[0, 0]),
        "fy": float(camera.K[1, 1]),
    }


def at_psnr(reels: list[tuple[float, float]], decibels: float) -> float | None:
    """Return the bytes of the reel at a PSNR, between its rates; None beyond them."""
    sizes, qualities = np.array(sorted(reels, key=lambda rate: rate[1])).T
    if not qualities[0] <= decibels <= qualities[-1]:
        return None
    return float(np.exp(np.interp(decibels, qualities, np.log(sizes))))


def main() -> None:
    """Measure all formats, print a table, and record it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("film", type=Path)
    parser.add_argument("--cameras", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--images", type=int, default=6)
    parser.add_argument("--antialiased", action="store_true")
    parser.add_argument("--train", type=int, help="width that a film is trained at; FILM is then a capture")
    parser.add_argument("--frames", help="frames of the capture, A:B")
    parser.add_argument("--fit", choices=("draft", "standard"), help="also import with --fit")
    parser.add_argument("--note", default="")
    parser.add_argument("--splat-transform", default="npx --yes @playcanvas/splat-transform")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    if given.train is not None:
        train_film(given)
    film = open_frames(given.film)
    judge = Judge(film, read_cameras(given.cameras), given.images, given.antialiased)
    measures: list[tuple[str, Callable[..., tuple[float, float]], Any]]
    steps = {f"reel, {rate}": step for rate, step in COARSENESS.items()} | {f"reel, {step}": step for step in COARSER}
    measures = [(name, measure_reel, step) for name, step in steps.items()]
    measures += [(f"reel, --fit {given.fit}", measure_fit, given.fit)] if given.fit else []
    measures += [(f".4dgs, {profile}", measure_fourdgs, profile) for profile in ("fine", "default", "coarse")]
    measures += [(suffix, measure_files, suffix) for suffix in (".spz", ".compressed.ply", ".sog")]
    print("| format | KB per frame | PSNR, dB | reel at that PSNR, KB |\n|---|---|---|---|")
    found: dict[str, tuple[float, float]] = {}
    kinds: dict[str, dict[str, float]] = {}
    for name, measure, how in measures:
        size, decibels = found[name] = measure(given, film, judge, how)
        same = None if measure in (measure_reel, measure_fit) else at_psnr([found[name] for name in steps], decibels)
        cells = [name, f"{size / 1000:.1f}", f"{decibels:.2f}", "" if same is None else f"{same / 1000:.1f}"]
        print(f"| {' | '.join(cells)} |", flush=True)
        kinds[name] = {"bytes_per_frame": round(size), "psnr": round(decibels, 2)}
        if same is not None:
            kinds[name]["reel_at_that_psnr"] = round(same)
    values = {"frames": len(film), "points": len(film.read(0)), "film_bytes": film.size, "formats": kinds}
    record(f"sequence {'independently trained' if given.train else given.film.name}", values, given.note)


if __name__ == "__main__":
    main()
