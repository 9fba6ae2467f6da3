"""Films of Gaussians, as other methods write them, made into reels by `splatreel import`: bytes, and what is lost.

python benchmarks/sequence.py REEL --cameras CAPTURE

The film is a reel's own, written as a PLY file a frame in three ways: as it is (the same points in the same rows within a group of the
reel); with all that moves changing its size by 30 % all the time, as methods do whose networks change shapes; and with all rows
shuffled in every frame, so that only what rests can be recognized.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tyro
from tyro.conf import Positional

from record import record
from splatreel.cli.main import main as splatreel
from splatreel.codec.reader import ReelReader
from splatreel.config import Rate
from splatreel.play.timeline import Moment, Timeline, open_reel
from splatreel.progress import Silent
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.ply import write_ply
from splatreel.sequence.comparison import compare
from splatreel.sequence.frames import open_frames

SIZES, EVERY = 0.3, 21
"""By which the logarithm of a size changes, at most, and the frames in which it does so once."""


def as_it_is(moment: Moment, frame: int) -> Gaussians:
    return moment


def changing_sizes(moment: Moment, frame: int) -> Gaussians:
    phase = np.random.default_rng(1).uniform(0, 2 * np.pi, len(moment))
    change = np.exp(SIZES * np.sin(2 * np.pi * frame / EVERY + phase))
    scales = moment.scales * np.where(moment.rests, 1, change)[:, None]
    return Gaussians(moment.means, moment.quats, scales, moment.opacities, moment.sh)


def shuffled(moment: Moment, frame: int) -> Gaussians:
    plain = Gaussians(moment.means, moment.quats, moment.scales, moment.opacities, moment.sh)
    return plain[np.random.default_rng(frame).permutation(len(moment))]


KINDS: dict[str, Callable[[Moment, int], Gaussians]] = {
    "as it is": as_it_is,
    "changing sizes": changing_sizes,
    "shuffled": shuffled,
}


def main(
    reel: Positional[Path],
    cameras: Path | None = None,
    frames: int = 60,
    rate: Rate = "high",
    out: Path = Path("out/sequence"),
    note: str = "",
) -> None:
    """Write, import, compare, record; existing reels in OUT are deleted by hand."""
    timeline = open_reel(reel)
    for kind, change in KINDS.items():
        folder, made = out / kind.replace(" ", "-"), out / f"{kind.replace(' ', '-')}-{rate}"
        write_film(timeline, folder, change, min(frames, timeline.frames))
        started = time.monotonic()
        where = [] if cameras is None else ["--cameras", str(cameras)]
        if splatreel(["import", str(folder), "--out", str(made), "--fps", str(timeline.fps), "--rate", rate, *where]):
            sys.exit(1)
        film, manifest = open_frames(folder), ReelReader(made).manifest
        found = {
            "reel_from": reel.parent.name,
            "rate": rate,
            "frames": len(film),
            "points": len(film.read(0)),
            "film_bytes": film.size,
            "reel_bytes": sum(file.bytes for file in manifest.files),
            "groups": len(manifest.groups),
            "psnr": round(compare(film, made, Silent()).psnr, 2),
            "seconds": round(time.monotonic() - started, 1),
        }
        print(record(f"sequence {kind}", found, note))


def write_film(timeline: Timeline, folder: Path, change: Callable[[Moment, int], Gaussians], frames: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for frame in range(frames):
        write_ply(folder / f"{frame:06}.ply", change(timeline.at(frame / timeline.fps), frame))


if __name__ == "__main__":
    tyro.cli(main)
