"""Remembers what a run says beside its bar."""

from splatreel.base.progress import Silent


class Notes(Silent):
    """lines: the notes, the first first."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def note(self, text: str) -> None:
        self.lines.append(text)
