"""`splatreel encode`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from splatreel.base.display import console
from splatreel.base.errors import UsageError
from splatreel.cli.info import describe
from splatreel.cli.options import RunFolder, Set, check_effect, check_out, new_reel, parse_renditions, parse_set
from splatreel.cli.printing import already_complete, say
from splatreel.config import COARSENESS, Codec, Config, EncodeConfig, Rate, Source
from splatreel.config.settings import changed
from splatreel.config.settings import settings as known_settings


def encode(
    run: RunFolder,
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
    settings: Set = (),
) -> None:
    """Encode a finished reconstruction again with other settings, without training.

    Args:
        run: Output folder of `reconstruct` or `demo`, with its work folder.
        out: Folder of the new reel.
        codec: predictive, or h265 as in the paper; --crf, --position-bits, --scale-bits, --sh-entries and --source need h265.
        rate: Rate of the predictive codec: high has twice the precision of medium, low about half its bytes.
        renditions: Rates, such as high,medium,low, that all groups are written in for a player to choose from. Layers have the best
            one.
        target_mbps: Megabits per second of video of the whole reel, instead of a rate; met within 5 %.
        crf: Quality of the lossy offset tracks; lower is better and larger.
        position_bits: Bits of a coordinate of a point.
        scale_bits: Bits of a scale.
        sh_entries: Size of the codebook of view-dependent color; 0 drops it.
        source: Form of the motion that becomes video: ofs, offsets; ori, positions; dif, differences from frame to frame; raw, offsets
            as float32. The web player plays ofs only.
        settings: Any setting of encode that `splatreel config` lists, such as encode.h265.fold=false; may be repeated.
    """
    from splatreel.codec.inspection import reel_info
    from splatreel.play.presentation_writer import PresentationWriter
    from splatreel.run.output.reencode import reencode

    check_out("--out", out, run, below=False)
    check_out("--out", out, run / "reel", run / "work")
    options = {
        "h265.crf": crf,
        "h265.position_bits": position_bits,
        "h265.scale_bits": scale_bits,
        "h265.source": source,
    }
    options |= {"sh_entries": sh_entries, "codec": codec}
    asked = _given_options(options, settings)
    papers = sorted(option for name, (option, _) in asked.items() if name.startswith("h265."))
    start = EncodeConfig(
        codec="h265" if papers else "predictive",
        coarseness=COARSENESS[rate or "medium"],
        renditions=parse_renditions(renditions),
    )
    config = changed(start, {name: value for name, (_, value) in asked.items()})
    _check_rate(config, rate, target_mbps, papers)
    check_effect(Config(encode=config), {f"encode.{name}": option for name, (option, _) in asked.items()})
    if "coarseness" in asked and (rate is not None or target_mbps is not None):
        raise UsageError(
            "--rate and --target-mbps have no effect with --set encode.coarseness. Leave out one of the two."
        )
    with console() as progress, new_reel(out) as made:
        reencode(
            run / "work",
            made.path,
            config,
            # The search for a rate writes reels that are not final.
            progress if target_mbps is not None else made.checked(progress, "layers", "groups"),
            target_mbps,
            PresentationWriter(_texts_of(run)),
        )
    if made.existing is not None:
        say(already_complete(out))
    say(describe(str(out), reel_info(out)))


def _given_options(options: dict[str, Any], settings: tuple[str, ...]) -> dict[str, tuple[str, Any]]:
    """Return the options that are given, by name in `EncodeConfig`: the option and its value."""
    found: dict[str, tuple[str, Any]] = {}
    for name, value in options.items():
        if value is not None:
            option = f"--{name.removeprefix('h265.').replace('_', '-')}"
            known_settings()[f"encode.{name}"].kind.check(option, value)
            found[name] = option, value
    for name, value in parse_set(settings).items():
        if not name.startswith("encode."):
            raise UsageError(f"--set {name}: takes effect in training only. Give a setting of encode.")
        found[name.removeprefix("encode.")] = f"--set {name}", value
    return found


def _texts_of(run: Path) -> dict[str, str]:
    """Return the texts of the run's own reel, if it still exists."""
    from splatreel.codec.presentation import MAX_TEXT
    from splatreel.codec.reader import ReelReader

    if not (run / "reel" / "manifest.json").is_file():
        return {}
    presentation = ReelReader(run / "reel").manifest.presentation
    return {name: text for name in MAX_TEXT if (text := getattr(presentation, name))}


def _check_rate(config: EncodeConfig, rate: Rate | None, mbps: float | None, papers: list[str]) -> None:
    if config.codec == "h265" and (rate or config.renditions or mbps is not None):
        raise UsageError(
            "--rate, --renditions and --target-mbps are of the predictive codec. Leave out --codec h265 and the paper's options."
        )
    if config.renditions and (rate or mbps is not None):
        raise UsageError("--renditions names all rates. Leave out --rate and --target-mbps.")
    if config.codec == "predictive" and papers:
        raise UsageError(f"{papers[0]} is of the paper's codec. Choose --codec h265, or leave it out.")
    if mbps is not None and (rate is not None or not 0 < mbps < 1e5):
        raise UsageError(f"--target-mbps {mbps:g}: give a positive rate, and no --rate beside it.")
