"""Writes the presentation of a reel while the reel is written: texts, a poster, thumbnails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from splatreel.codec.presentation import check_text
from splatreel.codec.writer import ReelWriter
from splatreel.play.poster import write_poster
from splatreel.play.thumbnails import write_thumbnails
from splatreel.play.timeline import open_reel


@dataclass(frozen=True)
class PresentationWriter:
    """Callback of a reel writer that keeps the presentation up to date.

    Call it with the writer and the number of the group that was just written, or None just before the reel is complete. It raises
    `ReelError` if a text is too long or a file cannot be written.
    """

    words: Mapping[str, str] = field(default_factory=dict)
    """Texts to set: any of `title`, `author`, `description` and `licence`. The others do not change."""
    otherwise: Mapping[str, str] = field(default_factory=dict)
    """Texts to set if the reel has none of that name."""

    def __call__(self, writer: ReelWriter, group: int | None) -> None:
        """Write what changed of the presentation."""
        before = writer.manifest.presentation
        missing = {name: text for name, text in self.otherwise.items() if not getattr(before, name)}
        words = {name: check_text(name, text) for name, text in (missing | dict(self.words)).items()}
        after = replace(before, **words)
        if group == 0 or after.poster is None:
            after = replace(after, poster=write_poster(writer, open_reel(writer.path)))
        if group is not None:
            after = replace(after, thumbnails=None)  # they belong to an earlier, complete reel
        elif after.thumbnails is None:
            after = replace(after, thumbnails=write_thumbnails(writer, open_reel(writer.path)))
        if after != before:
            writer.present(after)
