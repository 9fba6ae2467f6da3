"""Reconstruct the built-in capture as `splatreel demo` does.

python benchmarks/demo.py
"""

import dataclasses
import time
from pathlib import Path

import tyro

from run import run
from splatreel.capture.opening import open_capture
from splatreel.cli.demo import demo_config
from splatreel.cli.reconstruct import Deformation
from splatreel.config import Quality
from toyroom.capture import make_capture


def main(
    quality: Quality = "standard",
    deformation: Deformation = "trajectory",
    frames: int = 60,
    seed: int = 0,
    out: Path | None = None,
    note: str = "",
) -> None:
    """Film, reconstruct, evaluate, record."""
    out = out or Path(f"out/benchmark-demo-{quality}-{deformation}-{frames}-{seed}")
    started = time.monotonic()
    capture = open_capture(make_capture(out / "capture", frames=frames, seed=seed))
    filming = time.monotonic() - started
    config = demo_config(quality, seed)
    config = dataclasses.replace(config, group=dataclasses.replace(config.group, deformation=deformation))
    run(f"demo {deformation}", capture, out, config, None, note, filming)


if __name__ == "__main__":
    tyro.cli(main)
