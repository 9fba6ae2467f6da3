"""Settings, GPU, checkpoints and progress display that all stages of a run share."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from splatreel.base.process import give_back_freed_memory
from splatreel.base.progress import Progress, Span
from splatreel.config import Config
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.run.run_history import RecordedProgress
from splatreel.run.steps import STEPS
from splatreel.run.store import Store
from splatreel.scene.group import GroupSpan

READING = "reading"
"""Name of the seconds of reading images."""
Seconds = dict[str, float]
"""Seconds by the names that measured seconds have (`Step.timing`)."""


def sum_seconds(parts: Iterable[Seconds]) -> Seconds:
    """Return the sum of several parts, name by name."""
    found: Seconds = {}
    for part in parts:
        for name, seconds in part.items():
            found[name] = found.get(name, 0.0) + seconds
    return found


@dataclass(frozen=True)
class Plan:
    """The steps of a job in their order, with the seconds that each is expected to take.

    Attributes:
        steps: Name, group (None for a step outside of groups) and seconds of each step. The progress display does not show a step
            without a text, and adds its seconds to the next step.
        reading: Seconds of reading the images, during which no step is shown.
    """

    steps: tuple[tuple[str, int | None, float], ...]
    reading: float = 0.0

    @property
    def total(self) -> float:
        """Seconds of all steps."""
        return sum(seconds for *_, seconds in self.steps)

    @property
    def seconds(self) -> Seconds:
        """Seconds by name, without those that take no time."""
        parts = [{STEPS[step].timing: seconds} for step, _, seconds in self.steps if seconds]
        return sum_seconds([*parts, {READING: self.reading}] if self.reading else parts)

    def share(self, step: str, group: int | None) -> Span:
        """Return where a step begins and ends, as shares 0..1 of the whole job.

        Raises:
            KeyError: The job has no such step.
        """
        total, begin, end = self.total, 0.0, 0.0
        for name, index, seconds in self.steps:
            end += seconds
            if (name, index) == (step, group):
                return begin / total, end / total
            if STEPS[name].text:
                begin = end
        raise KeyError((step, group))


@dataclass
class Job:
    """A run, or one part of it, such as a chapter.

    Attributes:
        config: Settings of the run.
        progress: Display of the progress.
        store: Checkpoints of the run.
        plan: Expected seconds of the stages; None where the length is not known, as in a live run.
        part: Name of the part, such as chapter0003; empty for a run that has no parts.
        groups: Number of groups of the whole video, for the progress display.
        gpu: GPU that runs iterations of training; None runs them on the CPU.
        seconds: Seconds spent so far by stage, summed over groups and interrupted runs.
    """

    config: Config
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
        return "cpu" if self.gpu is None else self.gpu.kind

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the seconds spent in the block to a stage, and return freed memory to the system at its end."""
        start = time.monotonic()
        yield
        give_back_freed_memory()
        self.seconds[stage] = round(self.seconds.get(stage, 0.0) + time.monotonic() - start, 3)
        self.store.save_seconds(self.seconds, self.part)

    def show(self, step: str, steps: int, span: GroupSpan | None = None) -> None:
        """Begin the progress bar of a step.

        Args:
            step: Name of the step.
            steps: Number of steps of the bar.
            span: Group of the step; None outside of groups.
        """
        group = None if span is None else span.index
        number = "" if group is None else f"group {group + 1}{f'/{self.groups}' if self.plan else ''}: "
        share = None if self.plan is None else self.plan.share(step, group)
        self.progress.stage(number + STEPS[step].text, steps, share)
