"""Options that several verbs share: types and parsers of their values, texts of reels, and checks of outputs."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, overload

import tyro
from tyro.conf import arg

from splatreel.base.command_line import quoted
from splatreel.base.errors import ReelError, UsageError
from splatreel.base.new_folder import NewFolder, new_folder
from splatreel.config import COARSENESS, Config, Rate
from splatreel.config.settings import changed, parse_settings, without_effect

if TYPE_CHECKING:
    from splatreel.capture.opening import CaptureSource


AXES = {"x": (1, 0, 0), "-x": (-1, 0, 0), "y": (0, 1, 0), "-y": (0, -1, 0), "z": (0, 0, 1), "-z": (0, 0, -1)}
"""Directions of --up."""

Set = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(name="set", metavar="NAME=VALUE")]
"""Option --set NAME=VALUE, which may be repeated."""

ReelAddress = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="REEL")]
"""Folder or URL of a reel to read."""

OptionalReel = Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[REEL]")]
"""Folder or URL of a reel to read, which may be left out."""

RunFolder = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
"""Output folder of `reconstruct` or `demo`."""

ReelFolder = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="REEL")]
"""Folder of a reel on this machine."""

CaptureFolder = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAPTURE")]
"""Folder of a capture on this machine."""

OutFolder = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
"""Folder to write."""

CaptureAddress = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="CAPTURE")]
"""Folder of a capture to read, or an address such as s3://BUCKET/CAPTURE."""


@dataclass(frozen=True)
class CaptureOptions:
    """Images of a capture to train on."""

    width: int | None = None
    """Width of the images to train on, in pixels; by default their own."""
    scale: float | None = None
    """Size of the images to train on, as a share of their own, instead of the width."""
    frames: str | None = None
    """Frames A to B - 1, as A:B; by default all."""
    hold_out: str | None = None
    """Names of the cameras to keep for evaluation, as NAME,NAME; none trains on all; by default those of the format."""
    leave_out: str | None = None
    """Names of cameras that are not read at all, as NAME,NAME."""

    def check(self) -> None:
        """Raise `UsageError` unless frames and names are written correctly."""
        parse_frames(self.frames)
        parse_held_out(self.hold_out)
        parse_left_out(self.leave_out)

    def source(self, path: str | Path, masks: str | None = None) -> CaptureSource:
        """Return how to open a capture, or the subject of it that a folder of masks shows.

        Raises:
            UsageError: Frames or names are not written correctly.
        """
        frames, held_out = parse_frames(self.frames), parse_held_out(self.hold_out)
        from splatreel.capture.opening import CaptureSource

        request = {"width": self.width, "scale": self.scale, "frames": frames, "held_out": held_out}
        if left_out := parse_left_out(self.leave_out):
            request["leave_out"] = left_out
        if masks is not None:
            request["masks"] = masks
        return CaptureSource(path, request)


def check_arguments(arguments: Sequence[str]) -> None:
    """Refuse arguments that cannot be meant: a NUL character, an --out that looks like an option, an empty argument.

    An empty path would mean the current folder. Only texts of a reel may be empty.

    Raises:
        UsageError: There is such an argument.
    """
    before = ""
    for argument in arguments:
        name, equals, value = argument.partition("=")
        if "\0" in argument:
            raise UsageError("An argument holds a NUL character, which no file name can hold. Leave it out.")
        if argument.startswith("-") and not argument.startswith("--"):
            _check_no_name(argument, before)
        option, text = (name, value) if name.startswith("--") and equals else (before, argument)
        if not text and option not in TEXT_OPTIONS:
            what = option if option.startswith("--") else "An argument"
            raise UsageError(
                f"{what} is empty. Write a name, or . for the current folder; is a variable of the shell not set?"
            )
        before = argument


def _check_no_name(argument: str, before: str) -> None:
    """Refuse an argument with one dash that is the name of a file, or of a new one after --out.

    Raises:
        UsageError: The argument is such a name.
    """
    reason = "a name that starts with - is taken for an option"
    if before == "--out":
        raise UsageError(f"--out {argument}: {reason}. Write {quoted([f'--out=./{argument}'])}.")
    if argument not in (*AXES, "-h") and os.path.lexists(argument):
        raise UsageError(f"{argument}: {reason}. Write {quoted([Path(argument)])}.")


def parse_set(texts: tuple[str, ...]) -> dict[str, Any]:
    """Return settings by name.

    Raises:
        UsageError: There is no such setting, or it has no such value.
    """
    try:
        return parse_settings(texts)
    except UsageError as error:
        raise UsageError(f"--set {error}") from error


def with_set(config: Config, texts: tuple[str, ...]) -> Config:
    """Return the config with the settings of --set.

    Raises:
        UsageError: A setting is not possible.
    """
    values = parse_set(texts)
    try:
        return changed(config, values)
    except UsageError as error:
        raise UsageError(f"--set {error}") from error


def check_effect(config: Config, options: Mapping[str, str]) -> None:
    """Check that options have an effect.

    Args:
        config: Config with all options.
        options: Options by the name of their setting, such as --set encode.coarseness.

    Raises:
        UsageError: An option has no effect in the config.
    """
    for name, text in without_effect(config, options).items():
        raise UsageError(f"{options[name]} {text}. Change the other setting too, or leave this one out.")


def parse_frames(text: str | None) -> tuple[int, int] | None:
    """Return `A:B` as (first, end), with the end excluded. None stays None.

    Raises:
        UsageError: The text is not a range.
    """
    if text is None:
        return None
    match = re.fullmatch(r"([0-9]{1,9}):([0-9]{1,9})", text.strip())
    if match is None or int(match[1]) >= int(match[2]):
        raise UsageError(
            f"--frames {text!r:.60} is not a range of frames. Write A:B with A < B, such as 0:60 for the first 60."
        )
    return int(match[1]), int(match[2])


def parse_names(text: str | None, option: str) -> list[str] | None:
    """Return `0,10,cam03` as a list of names. None stays None.

    Raises:
        UsageError: A name is empty or given twice.
    """
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
    """Return names like `parse_names`; `none` is an empty list."""
    return [] if text is not None and text.strip() == "none" else parse_names(text, "--hold-out")


def parse_left_out(text: str | None) -> list[str]:
    """Return the names of --leave-out; none without it."""
    return parse_names(text, "--leave-out") or []


def parse_numbers(text: str | None, option: str) -> list[int] | None:
    """Return `0,14,28` as a list of frames. None stays None.

    Raises:
        UsageError: The text is something else, or names a frame twice.
    """
    names = parse_names(text, option)
    bad = [name for name in names or [] if re.fullmatch(r"[0-9]{1,9}", name) is None]
    if bad:
        raise UsageError(
            f"{option} {text!r:.60}: {bad[0]!r:.60} is not a frame. Write numbers with commas between them, such as 0,14."
        )
    return None if names is None else [int(name) for name in names]


def megabytes(count: int | None) -> int | None:
    """Return --max-memory in bytes. None stays None.

    Raises:
        UsageError: The number is less than one.
    """
    if count is not None and count < 1:
        raise UsageError(f"--max-memory {count}: give megabytes, 1 or more.")
    return None if count is None else count * 1_000_000


def parse_renditions(text: str | None) -> tuple[Rate, ...]:
    """Return `low,high` as rates, best first. None is an empty tuple.

    Raises:
        UsageError: A name is not a rate, or there are fewer than two.
    """
    names = parse_names(text, "--renditions") or []
    if text is not None and (len(names) < 2 or not set(names) <= set(COARSENESS)):
        raise UsageError(f"--renditions {text!r}: name two or more of {','.join(COARSENESS)}.")
    return tuple(rate for rate in COARSENESS if rate in names)


@overload
def reel_folder(path: Path) -> Path: ...


@overload
def reel_folder(path: str) -> str | Path: ...


def reel_folder(path: str | Path) -> str | Path:
    """Return the folder of a reel, also for the output folder of `reconstruct` or `demo`. A URL is returned as it is.

    Raises:
        UsageError: The folder is a capture.
    """
    from splatreel.codec.reader import find_reel

    folder = find_reel(path)
    if isinstance(folder, str) or (folder / "manifest.json").exists() or not folder.is_dir():
        return folder
    from splatreel.capture.opening import is_capture

    if is_capture(folder):
        raise UsageError(
            f"{path}: is a capture, not a reel. Make a reel of it with "
            f"`{quoted(['splatreel', 'reconstruct', folder, '--out', 'OUT'])}`, and give OUT."
        )
    return folder


TEXT_OPTIONS = ("--title", "--author", "--description", "--license", "--licence")
"""Options whose value may be empty."""


@dataclass(frozen=True)
class ReelTexts:
    """Texts that the player shows about a reel. A text that is not given stays as it is; an empty one is removed."""

    title: str | None = None
    """Title of the reel, in the player and where a link to it is shared."""
    author: str | None = None
    """Author of the reel."""
    description: str | None = None
    """A sentence or two about the reel."""
    licence: Annotated[str | None, arg(name="license")] = None
    """Terms on which others may use the reel, such as CC-BY-4.0."""

    def given(self) -> dict[str, str]:
        """Return the given texts, by their names in the manifest.

        Raises:
            UsageError: A text is too long, or cannot be stored.
        """
        from splatreel.codec.presentation import MAX_TEXT, check_text

        found = {name: value.strip() for name, value in dataclasses.asdict(self).items() if value is not None}
        for name, value in found.items():
            try:
                check_text(name, value)
            except ReelError as error:
                wrong = f"{len(value)} characters, at most {MAX_TEXT[name]} are possible. Shorten it."
                if len(value) <= MAX_TEXT[name]:
                    wrong = "is not text in this terminal's encoding. Enter it again."
                raise UsageError(f"--{'license' if name == 'licence' else name}: {wrong}") from error
        return found


_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")
"""Start of an address, of which a path keeps one slash."""


def check_out(option: str, out: Path | str, *sources: Path | str, below: bool = True) -> None:
    """Check the place that a verb writes to, before anything is created.

    Args:
        option: Name of the option or argument, for messages.
        out: File or folder to write.
        *sources: Folders and addresses that the verb reads.
        below: False allows folders in the sources, such as masks in the folder of a capture.

    Raises:
        UsageError: `out` is an address, one of the sources, or in one.
    """
    path = Path(out)
    if _ADDRESS.match(path.as_posix()) and not Path(path.parts[0]).exists():
        address = str(out) if "://" in str(out) else path.as_posix().replace(":/", "://", 1)
        raise UsageError(
            f"{option} {address}: is an address, and this command writes to "
            "this machine only. Name a file or folder here. `splatreel publish FOLDER ADDRESS` copies a reel to an address."
        )
    for source in sources:
        if _ADDRESS.match(Path(source).as_posix()) or not Path(source).is_dir():
            continue
        place, read = path.resolve(), Path(source).resolve()
        if place == read:
            raise UsageError(f"{option} {out}: is the folder that this command reads. Choose another place.")
        if below and place.is_relative_to(read):
            raise UsageError(
                f"{option} {out}: lies in {source}, which this command reads. Choose a place outside of it."
            )


@contextmanager
def new_reel(out: Path) -> Iterator[NewFolder]:
    """Yield a folder to write a reel into: `out`, locked, which may hold what an interrupted command left.

    If `out` holds a finished reel, the folder is a temporary one. Its reel must turn out the same.

    Raises:
        UsageError: The folder holds another finished reel, or the reel of a run.
    """
    from splatreel.run.run_folder import lock_reel

    refusal = _refusal(out)
    if out.name == "reel" and (out.parent / "work").is_dir() and (out / "manifest.json").is_file():
        raise refusal
    if not has_finished_reel(out):
        with lock_reel(out):
            if not has_finished_reel(out):
                yield NewFolder(out)
                return
    with new_folder(out, refusal) as made:  # an earlier command, or another process meanwhile, finished the reel
        yield made


def has_finished_reel(folder: Path) -> bool:
    """Return whether a folder holds a reel that is not being written."""
    from splatreel.codec.reader import ReelReader

    return (folder / "manifest.json").is_file() and not ReelReader(folder).manifest.live


def _refusal(out: Path) -> UsageError:
    return UsageError(f"--out {out}: holds a reel already. Choose another folder, or delete that reel.")
