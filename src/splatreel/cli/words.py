"""What people say about a reel, as options of the verbs that write one."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from splatreel.errors import ReelError, UsageError


@dataclass(frozen=True)
class Words:
    """Those that are given change, an empty one is taken out, the others stay."""

    title: str | None = None
    """What the reel is called, in the player and where a link to it is shared."""
    author: str | None = None
    """Who made it."""
    description: str | None = None
    """A sentence or two about it."""
    licence: str | None = None
    """On what terms others may use it, such as CC-BY-4.0."""

    def given(self) -> dict[str, str]:
        """By name. Raises `UsageError` for one that is too long."""
        from splatreel.codec.presentation import MAX_TEXT, check_text

        found = {name: value.strip() for name, value in dataclasses.asdict(self).items() if value is not None}
        for name, value in found.items():
            try:
                check_text(name, value)
            except ReelError as error:
                wrong = f"{len(value)} characters, at most {MAX_TEXT[name]} are possible. Shorten it."
                wrong = (
                    wrong if len(value) > MAX_TEXT[name] else "is no text in this terminal's encoding. Write it anew."
                )
                raise UsageError(f"--{name}: {wrong}") from error
        return found
