"""`splatreel encode`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

from splatreel.cli.info import describe
from splatreel.cli.options import parse_renditions
from splatreel.cli.output import say
from splatreel.cli.reconstruct import Codec
from splatreel.config import COARSENESS, EncodeConfig, Rate
from splatreel.config.settings import changed
from splatreel.errors import UsageError

Source = Literal["ofs", "ori", "dif", "raw"]


def encode(
    run: Positional[Path],
    /,
    out: Path,
    codec: Codec | None = None,
    rate: Rate | None = None,
    renditions: str | None = None,
    target_mbps: float | None = None,
    crf: int | None = None,
    position_bits: int | None = None,
    scale_bits: int | None = None,
    sh_entries: int | None = None,
    source: Source | None = None,
) -> None:
    """Encode a finished reconstruction again with other settings, without training.

    Args:
        run: Output folder of `reconstruct` or `demo`, with its work folder.
        out: Folder of the new reel.
        codec: predictive, or h265 as in the paper, which the options from --crf on are for.
        rate: Of the predictive codec: high has twice the precision of medium, low about half its bytes.
        renditions: Rates, such as high,medium,low, that all groups are written in for a player to choose from; layers are the best's.
        target_mbps: Megabits a second of video that the whole reel shall have, instead of a rate; met within 5 %.
        crf: Quality of the lossy offset tracks; lower is better and larger.
        position_bits: Bits of a coordinate of a point.
        scale_bits: Bits of a scale.
        sh_entries: Size of the codebook of view-dependent colour; 0 drops it.
        source: What of the motion becomes video: ofs, the offsets; ori, where points are; dif, differences from frame to frame; or
            raw, offsets as float32. The web player plays ofs only.
    """
    from splatreel.codec.info import reel_info
    from splatreel.play.presenter import Presenter
    from splatreel.progress import console
    from splatreel.recon.encode.publisher import encode as encode_checkpoints
    from splatreel.recon.run.run_lock import hold

    _check_folder(run, out)
    asked = {"crf": crf, "position_bits": position_bits, "scale_bits": scale_bits, "source": source}
    paper: dict[str, Any] = {f"h265.{name}": value for name, value in asked.items() if value is not None}
    config = EncodeConfig(
        codec=codec or ("h265" if paper else "predictive"),
        coarseness=COARSENESS[rate or "medium"],
        renditions=parse_renditions(renditions),
    )
    config = changed(config, paper | ({} if sh_entries is None else {"sh_entries": sh_entries}))
    _check_rate(config, rate, target_mbps, set(paper))
    progress = console()
    try:
        with hold(out):
            _check_folder(run, out)  # somebody else may have finished it by now
            encode_checkpoints(run / "work", out, config, progress, target_mbps, Presenter(_words_of(run)))
    finally:
        progress.close()
    say(describe(str(out), reel_info(out)))


def _words_of(run: Path) -> dict[str, str]:
    """What the run's own reel says for people, if there still is one."""
    from splatreel.codec.presentation import MAX_TEXT
    from splatreel.codec.reader import ReelReader

    if not (run / "reel" / "manifest.json").is_file():
        return {}
    presentation = ReelReader(run / "reel").manifest.presentation
    return {name: text for name in MAX_TEXT if (text := getattr(presentation, name))}


def _check_rate(config: EncodeConfig, rate: Rate | None, mbps: float | None, papers: set[str]) -> None:
    if config.codec == "h265" and (rate or config.renditions or mbps is not None):
        raise UsageError(
            "--rate, --renditions and --target-mbps are of the predictive codec. Leave out --codec h265 and the paper's options."
        )
    if config.renditions and (rate or mbps is not None):
        raise UsageError("--renditions names all rates. Leave out --rate and --target-mbps.")
    if config.codec == "predictive" and papers:
        raise UsageError(
            f"--{min(papers).removeprefix('h265.').replace('_', '-')} is of the paper's codec. "
            "Choose --codec h265, or leave it out."
        )
    if mbps is not None and (rate is not None or not 0 < mbps < 1e5):
        raise UsageError(f"--target-mbps {mbps:g}: give a positive rate, and no --rate beside it.")


def _check_folder(run: Path, out: Path) -> None:
    """A reel that somebody has made is not written over; one that is still live is what an interrupted `encode` left."""
    from splatreel.codec.reader import ReelReader

    if out.resolve() in (run.resolve(), (run / "reel").resolve(), (run / "work").resolve()):
        raise UsageError(f"--out {out}: belongs to the run itself. Choose another folder.")
    of_a_run = out.name == "reel" and (out.parent / "work").is_dir()
    if (out / "manifest.json").is_file() and (of_a_run or not ReelReader(out).manifest.live):
        raise UsageError(f"--out {out}: holds a reel already. Choose another folder, or delete that reel.")
