"""What to do where frames come faster than groups are made."""

from __future__ import annotations

from typing import Literal

from splatreel.config import Config
from splatreel.config.presets import DRAFT
from splatreel.config.settings import changed
from splatreel.progress import Progress

WhenLate = Literal["wait", "draft", "skip"]
"""wait: every group in order, later and later. draft: with the settings of draft until it has caught up. skip: groups are left out."""

QUICKER = ("keyframe.refine_iterations", "group.iterations_per_frame")
"""What draft has less of in the groups after the first."""


class Lateness:
    """Looks how far behind each group begins, and says so when it changes.

    length: seconds of a group. It is late when another group's frames are there before one begins, and has caught up when none are.
    """

    def __init__(self, config: Config, when_late: WhenLate, length: float, progress: Progress) -> None:
        self.config, self.when_late, self.length, self._progress = config, when_late, length, progress
        self.late = False
        self._draft = drafted(config)

    def settings(self, group: int, behind: float) -> Config:
        """How to make a group. behind: seconds of frames that are there beyond its own."""
        if not self.late and behind > self.length:
            self.late = True
            self._progress.note(
                f"Cannot keep up: group {group + 1} begins {behind:.1f} s late{self._remedy()} (--when-late {self.when_late})."
            )
        elif self.late and behind == 0:
            self.late = False
            self._progress.note(f"Group {group + 1}: caught up.")
        return self._draft if self.late and self.when_late == "draft" else self.config

    def _remedy(self) -> str:
        if self.when_late == "skip":
            return "; what was filmed meanwhile is left out"
        if self.when_late == "draft" and self._draft != self.config:
            return "; groups are made with the settings of draft until it has caught up"
        if self.when_late == "draft":
            return "; its settings are those of draft already. Ask for a smaller --width, or --when-late skip"
        return "; groups are shown later and later"


def drafted(config: Config) -> Config:
    """With as few iterations as draft has."""
    values = {"keyframe.refine_iterations": config.keyframe.refine_iterations}
    values["group.iterations_per_frame"] = config.group.iterations_per_frame
    return changed(config, {name: min(values[name], DRAFT[name]) for name in QUICKER})
