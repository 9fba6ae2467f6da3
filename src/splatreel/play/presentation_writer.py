"""Adds a reel's presentation while the reel is written: texts, a poster, thumbnails."""

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
    """Called with a writer and a group that was just published, or None when the reel is about to be complete.

    words: `title`, `author`, `description`, `licence`, those that shall change; the others stay as they are. otherwise: for those
    that there are none of.
    Raises `ReelError` for a text that is too long, and where files cannot be written.
    """

    words: Mapping[str, str] = field(default_factory=dict)
    otherwise: Mapping[str, str] = field(default_factory=dict)

    def __call__(self, writer: ReelWriter, group: int | None) -> None:
        before = writer.manifest.presentation
        missing = {name: text for name, text in self.otherwise.items() if not getattr(before, name)}
        words = {name: check_text(name, text) for name, text in (missing | dict(self.words)).items()}
        after = replace(before, **words)
        if group == 0 or after.poster is None:
            after = replace(after, poster=write_poster(writer, open_reel(writer.path)))
        if group is not None:
            after = replace(after, thumbnails=None)  # those of a reel that was complete, and now gets other groups
        elif after.thumbnails is None:
            after = replace(after, thumbnails=write_thumbnails(writer, open_reel(writer.path)))
        if after != before:
            writer.present(after)
