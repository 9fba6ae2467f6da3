"""Reaction to frames that arrive faster than groups are reconstructed."""

from __future__ import annotations

from typing import Literal

from splatreel.base.progress import Progress
from splatreel.config import Config
from splatreel.config.presets import DRAFT
from splatreel.config.settings import changed

WhenLate = Literal["wait", "draft", "skip"]
"""wait: reconstruct every group in order, with growing latency. draft: use draft settings until caught up. skip: skip groups."""

DRAFT_SETTINGS = ("keyframe.refine_iterations", "group.iterations_per_frame")
"""Settings of later groups that draft lowers."""


class Lateness:
    """Latency of a live run. It is late if another group's frames exist before a group begins, and caught up if none do.

    Attributes:
        config: Settings.
        when_late: Reaction to lateness.
        length: Length of a group, seconds.
        late: Whether the run is late.
    """

    def __init__(self, config: Config, when_late: WhenLate, length: float, progress: Progress) -> None:
        """Start caught up."""
        self.config = config
        self.when_late = when_late
        self.length = length
        self._progress = progress
        self.late = False
        self._draft = drafted(config)

    def settings(self, group: int, behind: float) -> Config:
        """Return the settings of a group, and report a change of lateness.

        Args:
            group: Number of the group.
            behind: Seconds of video that exist after the end of the group.
        """
        if not self.late and behind > self.length:
            self.late = True
            self._progress.note(
                f"Too slow: group {group + 1} starts {behind:.1f} s late{self._advice()} (--when-late {self.when_late})."
            )
        elif self.late and behind == 0:
            self.late = False
            self._progress.note(f"Group {group + 1}: caught up.")
        return self._draft if self.late and self.when_late == "draft" else self.config

    def _advice(self) -> str:
        if self.when_late == "skip":
            return "; the frames filmed meanwhile are skipped"
        if self.when_late == "draft" and self._draft != self.config:
            return "; draft settings are used until it has caught up"
        if self.when_late == "draft":
            return "; it uses draft settings already. Choose a smaller --width, or --when-late skip"
        return "; latency grows"


def drafted(config: Config) -> Config:
    """Return settings with at most the iterations of draft."""
    values = {"keyframe.refine_iterations": config.keyframe.refine_iterations}
    values["group.iterations_per_frame"] = config.group.iterations_per_frame
    return changed(config, {name: min(values[name], DRAFT[name]) for name in DRAFT_SETTINGS})
