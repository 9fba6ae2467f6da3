"""`splatreel encode`."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from tyro.conf import Positional

from splatreel.cli.info import describe
from splatreel.cli.reconstruct import Codec
from splatreel.config import EncodeConfig
from splatreel.errors import UsageError

LIMITS = {"crf": (0, 51), "position_bits": (4, 21), "scale_bits": (1, 16), "sh_entries": (0, 65536)}


def encode(
    run: Positional[Path],
    /,
    out: Path,
    codec: Codec | None = None,
    crf: int | None = None,
    position_bits: int | None = None,
    scale_bits: int | None = None,
    sh_entries: int | None = None,
) -> None:
    """Encode a finished reconstruction again with other settings, without training.

    Args:
        run: Output folder of `reconstruct` or `demo`, with its work folder.
        out: Folder of the new reel.
        codec: How offsets are coded.
        crf: Quality of the lossy offset tracks; lower is better and larger.
        position_bits: Bits of a coordinate of a point.
        scale_bits: Bits of a scale.
        sh_entries: Size of the codebook of view-dependent colour; 0 drops it.
    """
    from splatreel.codec.info import reel_info
    from splatreel.progress import console
    from splatreel.recon.publish import encode as encode_checkpoints

    _check_folder(run, out)
    asked = {"crf": crf, "position_bits": position_bits, "scale_bits": scale_bits, "sh_entries": sh_entries}
    given = {name: value for name, value in asked.items() if value is not None}
    for name, value in given.items():
        low, high = LIMITS[name]
        if not low <= value <= high:
            raise UsageError(f"--{name.replace('_', '-')} {value} is out of range. Choose {low} to {high}.")
    config = dataclasses.replace(EncodeConfig(codec=codec or EncodeConfig.codec), **given)
    progress = console()
    try:
        encode_checkpoints(run / "work", out, config, progress)
    finally:
        progress.close()
    print(describe(str(out), reel_info(out)))


def _check_folder(run: Path, out: Path) -> None:
    """A reel that somebody has made is not written over; one that is still live is what an interrupted `encode` left."""
    from splatreel.codec.reader import ReelReader

    if out.resolve() in (run.resolve(), (run / "reel").resolve(), (run / "work").resolve()):
        raise UsageError(f"--out {out}: belongs to the run itself. Choose another folder.")
    of_a_run = out.name == "reel" and (out.parent / "work").is_dir()
    if (out / "manifest.json").is_file() and (of_a_run or not ReelReader(out).manifest.live):
        raise UsageError(f"--out {out}: holds a reel already. Choose another folder, or delete that reel.")
