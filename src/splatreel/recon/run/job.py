"""What all stages of a run share: settings, device, checkpoints, and how a user hears of progress."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch

from splatreel.config import Config
from splatreel.process import give_back_freed_memory
from splatreel.progress import Progress, Span
from splatreel.recon.coverage.trial import Trial
from splatreel.recon.run.plan import Plan
from splatreel.recon.run.store import Store
from splatreel.scene.spans import GroupSpan


@dataclass
class Job:
    """A run, or one part of it. seconds: per stage, summed over the groups and over interrupted runs.

    spans: its groups. part: its name where there are others, such as chapter0003. groups: of the whole video, which is not known of an
    endless one.
    """

    config: Config
    device: torch.device
    progress: Progress
    store: Store
    spans: list[GroupSpan]
    part: str = ""
    groups: int = 0
    endless: bool = False
    plan: Plan = field(init=False)
    seconds: dict[str, float] = field(init=False)

    def __post_init__(self) -> None:
        self.groups = self.groups or len(self.spans)
        self.plan = Plan(self.spans, self.config)
        self.seconds = self.store.seconds(self.part)

    @property
    def trial(self) -> Trial | None:
        """How closely new views are met, where that was tried."""
        coverage = self.store.coverage()
        return coverage and coverage.trial

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Count the seconds that are spent inside towards a stage. What it needed no longer is given back."""
        start = time.monotonic()
        yield
        give_back_freed_memory()
        self.seconds[stage] = round(self.seconds.get(stage, 0.0) + time.monotonic() - start, 3)
        self.store.save_seconds(self.seconds, self.part)

    def say(self, group: GroupSpan, what: str, steps: int, share: Span) -> None:
        """Begin a bar of so many steps. share: which part of the whole job it is."""
        if self.endless:
            self.progress.stage(f"group {group.index + 1}: {what}", steps)
        else:
            self.progress.stage(f"group {group.index + 1}/{self.groups}: {what}", steps, share)
