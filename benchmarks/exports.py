"""Compare .4dgs files of a reel with the reel: bytes per frame and PSNR: python benchmarks/exports.py --help."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from importing import Judge
from record import record
from splatreel.formats.fourdgs import FourdgsScene
from splatreel.formats.fourdgs_writer import write_fourdgs
from splatreel.play.gaussian_export import GaussianExport
from splatreel.play.timeline import Timeline, open_reel
from splatreel.scene.gaussians import Gaussians, turned
from splatreel.scene.rotations import conjugate


class ReelFrames:
    """Frames of a reel, as `Judge` reads them."""

    def __init__(self, source: Timeline) -> None:
        self._source = source

    def __len__(self) -> int:
        return self._source.frames

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        return self._source.at(frame / self._source.fps)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reel", type=Path, help="a reel's folder")
    parser.add_argument("--file", type=Path, help="a .4dgs file of the reel that exists; by default one is written")
    parser.add_argument("--images", type=int, default=9, help="how many frames are compared")
    parser.add_argument("--record", metavar="NOTE", help="append to benchmarks/results.jsonl")
    arguments = parser.parse_args()
    source = open_reel(arguments.reel)
    film = GaussianExport(source, [frame / source.fps for frame in range(source.frames)], np.array([0.0, 1, 0]))
    judge = Judge(ReelFrames(source), list(source.manifest.cameras), arguments.images, source.manifest.antialias)  # pyright: ignore[reportArgumentType]
    with tempfile.TemporaryDirectory() as folder:
        file = arguments.file or Path(folder) / "film.4dgs"
        if arguments.file is None:
            write_fourdgs(file, film, source.fps)
        scene, back = FourdgsScene(file, source.fps), conjugate(film.placement.turn)
        values = {
            "frames": len(film.seconds),
            "reel_bytes_per_frame": round(sum(entry.bytes for entry in source.manifest.files) / len(film.seconds)),
            "bytes_per_frame": round(file.stat().st_size / len(film.seconds)),
            "rows": scene._scene.gaussians.count,
            "psnr": round(judge.psnr(lambda frame: turned(scene.read(frame), back)), 2),
        }
    print(json.dumps(values))
    if arguments.record is not None:
        record("export 4dgs", values, arguments.record)


if __name__ == "__main__":
    main()
