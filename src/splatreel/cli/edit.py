"""`splatreel edit`."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import OmitArgPrefixes, Positional

from splatreel.cli.options import reel_folder
from splatreel.cli.output import say
from splatreel.cli.words import Words
from splatreel.errors import UsageError


def edit(reel: Positional[Path], /, words: OmitArgPrefixes[Words] = Words()) -> None:  # noqa: B008 - it is frozen
    """Say of a reel what it is called, who made it, what it shows, and on what terms it may be used.

    Args:
        reel: Folder of the reel.
    """
    from splatreel.codec.edit import edit_reel

    given = words.given()
    if not given:
        raise UsageError("Nothing to change. Give --title, --author, --description or --licence.")
    folder = reel_folder(reel)
    manifest = edit_reel(folder, given)
    for name in given:
        say(f"{folder}: {name} {getattr(manifest.presentation, name) or 'taken out'}")
