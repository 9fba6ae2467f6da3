"""Settings, device, checkpoints and progress display that all stages of a run share."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch

from splatreel.base.process import give_back_freed_memory
from splatreel.base.progress import Progress, Span
from splatreel.config import Config
from splatreel.gpu.shared import SharedGpu
from splatreel.method.coverage.trial import Trial
from splatreel.run.run_history import RecordedProgress
from splatreel.run.store import Store
from splatreel.scene.spans import GroupSpan

POINTS = "points"
"""Name of the stage before the first group: the initial points, the cameras and the measures of the scene."""


@dataclass(frozen=True)
class Plan:
    """The stages of a job in their order, with the seconds that each is expected to take.

    Attributes:
        steps: Text of the progress display, group (None for the stage before the groups) and seconds of each stage. The progress
            display does not show a stage without a text, and adds its seconds to the next stage.
    """

    steps: tuple[tuple[str, int | None, float], ...]

    @property
    def total(self) -> float:
        """Seconds of all stages."""
        return sum(seconds for *_, seconds in self.steps)

    def share(self, text: str, group: int | None) -> Span:
        """Return where a stage begins and ends, as shares 0..1 of the whole job.

        Raises:
            KeyError: The job has no such stage.
        """
        total, begin, end = self.total, 0.0, 0.0
        for name, index, seconds in self.steps:
            end += seconds
            if (name, index) == (text, group):
                return begin / total, end / total
            if name:
                begin = end
        raise KeyError((text, group))


@dataclass
class Job:
    """A run, or one part of it, such as a chapter.

    Attributes:
        config: Settings of the run.
        device: Device that trains.
        progress: Display of the progress.
        store: Checkpoints of the run.
        plan: Expected seconds of the stages; None where the length is not known, as in a live run.
        part: Name of the part, such as chapter0003; empty for a run that has no parts.
        groups: Number of groups of the whole video, for the progress display.
        gpu: GPU that runs iterations of training; None runs them on `device`, with torch.
        seconds: Seconds spent so far by stage, summed over groups and interrupted runs.
    """

    config: Config
    device: torch.device
    progress: Progress
    store: Store
    plan: Plan | None = None
    part: str = ""
    groups: int = 0
    gpu: SharedGpu | None = None
    seconds: dict[str, float] = field(init=False)

    def __post_init__(self) -> None:
        """Read the seconds of earlier, interrupted runs, and record what the progress display shows."""
        self.progress = RecordedProgress(self.progress, self.store.work, self.part, self.device_name)
        self.seconds = self.store.seconds(self.part)

    @property
    def device_name(self) -> str:
        """Device that trains: cpu, cuda or gpu."""
        return self.device.type if self.gpu is None else "gpu"

    @property
    def trial(self) -> Trial | None:
        """Result of the trial that left a camera out; None where no trial was made."""
        coverage = self.store.coverage()
        return coverage and coverage.trial

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the seconds spent in the block to a stage, and return freed memory to the system at its end."""
        start = time.monotonic()
        yield
        give_back_freed_memory()
        self.seconds[stage] = round(self.seconds.get(stage, 0.0) + time.monotonic() - start, 3)
        self.store.save_seconds(self.seconds, self.part)

    def show(self, text: str, steps: int, span: GroupSpan | None = None) -> None:
        """Begin the progress bar of a stage.

        Args:
            text: Text of the stage, as the plan has it.
            steps: Number of steps of the bar.
            span: Group of the stage; None for the stage before the groups.
        """
        group = None if span is None else span.index
        number = "" if group is None else f"group {group + 1}{f'/{self.groups}' if self.plan else ''}: "
        self.progress.stage(number + text, steps, None if self.plan is None else self.plan.share(text, group))
