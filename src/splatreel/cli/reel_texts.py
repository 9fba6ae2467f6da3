"""Options for the texts of a reel: title, author, description and license."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from splatreel.base.errors import ReelError, UsageError

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
