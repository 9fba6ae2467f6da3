"""Panoptic Sports basketball: two groups, all training cameras, evaluated on the benchmark's test cameras 0, 10, 15, 30.

python benchmarks/basketball.py CAPTURE --width 320
"""

import dataclasses
from pathlib import Path

import tyro

from run import run
from splatreel.capture.opening import open_capture
from splatreel.cli.options import parse_frames
from splatreel.config import Quality, preset


def main(
    capture: tyro.conf.Positional[Path],
    /,
    width: int = 320,
    frames: str = "0:60",
    cameras: str | None = None,
    quality: Quality = "standard",
    seed: int = 0,
    out: Path | None = None,
    note: str = "",
) -> None:
    """Reconstruct, evaluate, record.

    Args:
        cameras: Names to evaluate on, separated by commas; by default the capture's test cameras.
    """
    out = out or Path(f"out/basketball-{width}-{quality}-{seed}")
    source = open_capture(capture, width=width, frames=parse_frames(frames))
    config = dataclasses.replace(preset(quality), seed=seed)
    run(f"basketball {width}", source, out, config, cameras.split(",") if cameras else None, note)


if __name__ == "__main__":
    tyro.cli(main)
