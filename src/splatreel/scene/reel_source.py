"""Frames and cameras of the capture that a reel was made from. An evaluation compares the reel with exactly these."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, cast, get_args

Part = Literal["masks", "region", "crop"]
"""Cause why a reel shows only a part of its scene: an option of `reconstruct`, or an operation of `edit`."""
PARTS: tuple[Part, ...] = get_args(Part)
_LAST_FRAME = 1 << 40
"""Largest frame number that is read."""
MAX_NAMES, MAX_NAME = 100_000, 200
"""Largest number of camera names that are read, and their largest length."""


@dataclass(frozen=True)
class ReelSource:
    """Frames and cameras of the capture that a reel was made from.

    Attributes:
        frame: Frame of the capture's files that frame 0 of the reel shows. Later frames follow one by one. None if the reel
            was reversed, joined or retimed, so that no such frame exists.
        held_out: Names of the cameras that were held out.
        left_out: Names of the cameras that were not read.
        part: Cause why the reel shows only a part of the scene; None if it shows all.
        edited: True if `edit` changed points or frames, so that the checkpoints of a run do not belong to the reel.
    """

    frame: int | None
    held_out: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    part: Part | None = None
    edited: bool = False

    def shifted(self, frames: int) -> ReelSource:
        """Return the source of a reel whose frame 0 is a later frame of this one."""
        return self if self.frame is None else replace(self, frame=self.frame + frames)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON value that `parse_reel_source` accepts. Entries without content are left out."""
        return {
            **({} if self.frame is None else {"frame": self.frame}),
            "held_out": list(self.held_out),
            **({"left_out": list(self.left_out)} if self.left_out else {}),
            **({"part": self.part} if self.part else {}),
            **({"edited": True} if self.edited else {}),
        }


def parse_reel_source(value: object) -> ReelSource | None:
    """Return the source from JSON, or None if it is absent or malformed. A reel plays without it, so nothing is refused."""
    if not isinstance(value, dict):
        return None
    frame, part = value.get("frame"), value.get("part")
    is_frame = isinstance(frame, int) and not isinstance(frame, bool) and 0 <= frame <= _LAST_FRAME
    held_out, left_out = _names(value.get("held_out")), _names(value.get("left_out", []))
    known = cast(Part, part) if part in PARTS else None
    if held_out is None or left_out is None or (part is not None and known is None) or not (frame is None or is_frame):
        return None
    return ReelSource(frame if is_frame else None, held_out, left_out, known, value.get("edited") is True)


def _names(value: object) -> tuple[str, ...] | None:
    if not isinstance(value, list) or len(value) > MAX_NAMES:
        return None
    names = tuple(name for name in value if isinstance(name, str) and len(name) <= MAX_NAME)
    return names if len(names) == len(value) else None
