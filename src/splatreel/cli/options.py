"""Option values that are more than a number or a path."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, overload

import tyro

from splatreel.cli.words import Words
from splatreel.config import COARSENESS, Config, Rate
from splatreel.config.settings import changed, parse_settings
from splatreel.errors import UsageError

Set = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(name="set", metavar="NAME=VALUE")]
"""--set NAME=VALUE, as often as one likes."""

ReelAddress = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="REEL")]
"""A reel to be read: a folder, or a URL."""


CaptureAddress = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="CAPTURE")]
"""A capture to be read: a folder, or an address such as s3://BUCKET/CAPTURE."""


def check_arguments(arguments: Sequence[str]) -> None:
    """Raise `UsageError` for a character NUL, and for an empty argument that is not the text of a reel: as a path it means here."""
    texts = {f"--{field.name}" for field in fields(Words)}
    before = ""
    for argument in arguments:
        name, _, value = argument.partition("=")
        if "\0" in argument:
            raise UsageError("An argument holds a character NUL, which no name of a file can. Leave it out.")
        if not argument and before not in texts:
            what = before if before.startswith("--") else "An argument"
            raise UsageError(
                f"{what} is empty. Write a name, or . for the current folder; is a variable of the shell not set?"
            )
        if name.startswith("--") and "=" in argument and not value and name not in texts:
            raise UsageError(
                f"{name} is empty. Write a name, or . for the current folder; is a variable of the shell not set?"
            )
        before = argument


def parse_set(texts: tuple[str, ...]) -> dict[str, Any]:
    """Settings by name. Raises `UsageError` for what is no setting, or no value of it."""
    try:
        return parse_settings(texts)
    except UsageError as error:
        raise UsageError(f"--set {error}") from error


def with_set(config: Config, texts: tuple[str, ...]) -> Config:
    """The config with the settings of --set. Raises `UsageError` where they do not fit."""
    values = parse_set(texts)
    try:
        return changed(config, values)
    except UsageError as error:
        raise UsageError(f"--set {error}") from error


def parse_frames(text: str | None) -> tuple[int, int] | None:
    """`A:B` as (first, end), end exclusive; None stays None. Raises `UsageError` for anything else."""
    if text is None:
        return None
    match = re.fullmatch(r"([0-9]{1,9}):([0-9]{1,9})", text.strip())
    if match is None or int(match[1]) >= int(match[2]):
        raise UsageError(
            f"--frames {text!r:.60} is no range of frames. Write A:B with A < B, such as 0:60 for the first 60."
        )
    return int(match[1]), int(match[2])


def parse_names(text: str | None, option: str) -> list[str] | None:
    """`0,10,cam03` as a list of names; None stays None. Raises `UsageError` for an empty name or one given twice."""
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise UsageError(
            f"{option} {text!r} holds an empty name. Write names with commas between them, such as cam00,cam10."
        )
    if len(set(names)) < len(names):
        twice = next(n for n in names if names.count(n) > 1)
        raise UsageError(f"{option} {text!r} names {twice!r} twice.")
    return names


def parse_held_out(text: str | None) -> list[str] | None:
    """As `parse_names`; `none` is no camera."""
    return [] if text is not None and text.strip() == "none" else parse_names(text, "--hold-out")


def parse_numbers(text: str | None, option: str) -> list[int] | None:
    """`0,14,28` as a list of frames; None stays None. Raises `UsageError` for anything else, or a number given twice."""
    names = parse_names(text, option)
    bad = [name for name in names or [] if re.fullmatch(r"[0-9]{1,9}", name) is None]
    if bad:
        raise UsageError(
            f"{option} {text!r:.60}: {bad[0]!r:.60} is no frame. Write numbers with commas between them, such as 0,14."
        )
    return None if names is None else [int(name) for name in names]


def megabytes(count: int | None) -> int | None:
    """--max-memory as bytes; None stays None. Raises `UsageError` for none at all."""
    if count is not None and count < 1:
        raise UsageError(f"--max-memory {count}: give megabytes, 1 or more.")
    return None if count is None else count * 1_000_000


def parse_renditions(text: str | None) -> tuple[Rate, ...]:
    """`low,high` as rates, best first; None is none. Raises `UsageError` for what is no rate, or fewer than two."""
    names = parse_names(text, "--renditions") or []
    if text is not None and (len(names) < 2 or not set(names) <= set(COARSENESS)):
        raise UsageError(f"--renditions {text!r}: name two or more of {','.join(COARSENESS)}.")
    return tuple(rate for rate in COARSENESS if rate in names)


@overload
def reel_folder(path: Path) -> Path: ...


@overload
def reel_folder(path: str) -> str | Path: ...


def reel_folder(path: str | Path) -> str | Path:
    """The reel itself, where the output folder of `reconstruct` or `demo` is given instead of its `reel` folder; a URL as it is."""
    from splatreel.storage.addresses import is_url

    if isinstance(path, str) and is_url(path):
        return path
    folder = Path(path)
    inside = folder / "reel"
    return inside if not (folder / "manifest.json").exists() and (inside / "manifest.json").exists() else folder


def check_no_reel(out: Path) -> None:
    """Raise `UsageError` where writing a reel into --out would destroy one that somebody has made, or is making.

    One that is still live is what the same command left when it was interrupted, but for that of a run.
    """
    from splatreel.codec.reader import ReelReader

    of_a_run = out.name == "reel" and (out.parent / "work").is_dir()
    if (out / "manifest.json").is_file() and (of_a_run or not ReelReader(out).manifest.live):
        raise UsageError(f"--out {out}: holds a reel already. Choose another folder, or delete that reel.")
