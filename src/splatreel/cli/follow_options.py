"""Options of `splatreel reconstruct` for a capture that is still being written."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Literal

from splatreel.base.errors import UsageError
from splatreel.cli.printing import playable
from splatreel.storage.address import local_path

if TYPE_CHECKING:
    from splatreel.base.progress import Progress
    from splatreel.capture.opening import CaptureSource
    from splatreel.run.output.group_writer import PresentationHook
    from splatreel.run.pipeline import RunSpec


@dataclass(frozen=True)
class FollowOptions:
    """Reconstruction of a capture that is still being written (docs/live.md)."""

    follow: bool = False
    """The capture is still being written: show each group soon after it is filmed (docs/live.md)."""
    follow_timeout: float = 30.0
    """With --follow: seconds without a new frame after which the capture has ended."""
    when_late: Literal["wait", "draft", "skip"] = "wait"
    """With --follow, if groups take longer to make than they last. wait: make all groups, with a growing delay; draft: use quicker
    settings until the delay is gone; skip: leave out what was filmed meanwhile, so that nothing moves there."""
    keep: float | None = None
    """With --follow: seconds that the reel keeps; all by default."""

    def check(self) -> None:
        """Check that the options fit together.

        Raises:
            UsageError: They do not.
        """
        changed = [field.name for field in fields(self) if getattr(self, field.name) != field.default]
        if changed and not self.follow:
            option = changed[0].replace("_", "-")
            raise UsageError(f"--{option} is for captures that are still being written. Add --follow, or leave it out.")
        for option, seconds in (("follow-timeout", self.follow_timeout), ("keep", self.keep)):
            if seconds is not None and not 0 < seconds < math.inf:
                raise UsageError(f"--{option} {seconds:g}: give seconds, more than 0.")

    def reconstruct(self, source: CaptureSource, spec: RunSpec, progress: Progress, present: PresentationHook) -> str:
        """Reconstruct the capture while it is written, and return the closing message.

        Args:
            source: The capture and how to open it.
            spec: The run.
            progress: Display of the progress.
            present: Adds poster and thumbnails to the reel.
        """
        path = local_path(source.path)
        if path is None:
            raise UsageError(
                f"--follow: {source.path} is not a folder of this machine. Run the command on the machine that writes the capture."
            )
        from splatreel.capture.follower import Follower, open_growing
        from splatreel.capture.growth import Growth
        from splatreel.run.live.following import Live, reconstruct_following

        growth = Growth(path, self.follow_timeout)
        with (
            closing(open_growing(path, growth, progress.note, **source.request)) as capture,
            Follower(capture, growth, progress.note) as follower,
        ):
            result = reconstruct_following(
                follower,
                spec.out,
                spec.config,
                Live(self.when_late, self.keep),
                sound=spec.sound,
                device=spec.device,
                progress=progress,
                present=present,
            )
            return playable(result.reel)
