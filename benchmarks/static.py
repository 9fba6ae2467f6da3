"""One time step of a capture as a static scene: the limit that a dynamic reconstruction of the same frame can reach.

python benchmarks/static.py CAPTURE --width 672
"""

import dataclasses
from pathlib import Path

import tyro

from run import run
from splatreel.capture.opening import open_capture
from splatreel.config import Quality, preset


def main(
    capture: tyro.conf.Positional[Path],
    /,
    width: int = 672,
    frame: int = 0,
    hold_out: str | None = None,
    quality: Quality = "standard",
    seed: int = 0,
    out: Path | None = None,
    note: str = "",
) -> None:
    """Reconstruct one frame, evaluate on the held-out cameras, record. hold_out: their names, with commas."""
    held_out = hold_out.split(",") if hold_out else None
    source = open_capture(capture, width=width, frames=(frame, frame + 1), held_out=held_out)
    out = out or Path(f"out/static-{source.name}-{width}-{frame}-{quality}")
    config = dataclasses.replace(preset(quality), seed=seed)
    run(f"static {source.name} {width}", source, out, config, None, note)


if __name__ == "__main__":
    tyro.cli(main)
