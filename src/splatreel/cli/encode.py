"""`splatreel encode`."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from tyro.conf import Positional

from splatreel.cli.info import describe
from splatreel.cli.reconstruct import Codec
from splatreel.config import EncodeConfig
from splatreel.errors import UsageError


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

    if out.resolve() == (run / "reel").resolve():
        raise UsageError(f"--out {out}: is the reel of the run itself. Choose another folder.")
    given = {
        "codec": codec,
        "crf": crf,
        "position_bits": position_bits,
        "scale_bits": scale_bits,
        "sh_entries": sh_entries,
    }
    config = dataclasses.replace(EncodeConfig(), **{name: value for name, value in given.items() if value is not None})
    progress = console()
    try:
        encode_checkpoints(run / "work", out, config, progress)
    finally:
        progress.close()
    print(describe(str(out), reel_info(out)))
