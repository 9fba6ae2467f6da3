"""`splatreel edit`."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import OmitArgPrefixes, Positional

from splatreel.cli.options import reel_folder
from splatreel.cli.printing import say
from splatreel.cli.reel_texts import ReelTexts
from splatreel.errors import UsageError


def edit(reel: Positional[Path], /, texts: OmitArgPrefixes[ReelTexts] = ReelTexts()) -> None:  # noqa: B008 - it is frozen
    """Change the title, author, description or license of a reel.

    Args:
        reel: Folder of the reel.
        texts: The new texts.
    """
    from splatreel.codec.edit import edit_reel

    given = texts.given()
    if not given:
        raise UsageError("Nothing to change. Give --title, --author, --description or --license.")
    folder = reel_folder(reel)
    manifest = edit_reel(folder, given)
    for name in given:
        option = "license" if name == "licence" else name
        say(f"{folder}: {option} {getattr(manifest.presentation, name) or 'removed'}")
