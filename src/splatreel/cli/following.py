"""What `splatreel reconstruct` takes of a capture that is still being written."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from splatreel.cli.output import playable
from splatreel.config import Config
from splatreel.errors import UsageError
from splatreel.storage.addresses import local_path


@dataclass(frozen=True)
class Following:
    follow: bool = False
    """The capture is still being written: groups are shown soon after they are filmed (docs/live.md)."""
    follow_timeout: float = 30.0
    """With --follow: seconds without a new frame after which the capture has ended."""
    when_late: Literal["wait", "draft", "skip"] = "wait"
    """With --follow, when groups take longer to make than they last. wait: all in order, later and later; draft: quicker settings
    until it has caught up; skip: what was filmed meanwhile is left out, and nothing moves there."""
    keep: float | None = None
    """With --follow: seconds that the reel keeps; all by default."""

    def check(self) -> None:
        """Raises `UsageError` for what cannot be."""
        changed = [field.name for field in fields(self) if getattr(self, field.name) != field.default]
        if changed and not self.follow:
            option = changed[0].replace("_", "-")
            raise UsageError(
                f"--{option} is of captures that are still being written. Give --follow as well, or leave it out."
            )
        for option, seconds in (("follow-timeout", self.follow_timeout), ("keep", self.keep)):
            if seconds is not None and not 0 < seconds < math.inf:
                raise UsageError(f"--{option} {seconds:g}: give seconds, more than 0.")

    def reconstruct(
        self, capture_path: str, out: Path, config: Config, request: dict[str, Any], output: dict[str, Any]
    ) -> str:
        """As `pipeline.reconstruct`; returns what to say at the end.

        request: of `open_capture`. output: what that takes of sound, device, progress and more.
        """
        path = local_path(capture_path)
        if path is None:
            raise UsageError(
                f"--follow: {capture_path} is no folder of this machine. Follow the capture where it is written."
            )
        from splatreel.capture.follower import Follower, open_growing
        from splatreel.capture.growing.growth import Growth
        from splatreel.recon.live.following import Live, reconstruct_following

        growth, tell = Growth(path, self.follow_timeout), output["progress"].note
        with (
            closing(open_growing(path, growth, tell, **request)) as capture,
            Follower(capture, growth, tell) as follower,
        ):
            return playable(
                reconstruct_following(follower, out, config, Live(self.when_late, self.keep), **output).reel
            )
