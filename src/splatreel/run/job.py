"""Job: settings, GPU, checkpoints and progress display that all stages of a run share, and the execution of its steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar, TypeVarTuple

from splatreel.base.process import give_back_freed_memory
from splatreel.base.progress import Progress, Span
from splatreel.config import Config
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.run.run_logs import RecordedProgress
from splatreel.run.steps import STEPS
from splatreel.run.store import GroupStore, Store
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


Found = TypeVar("Found")
Arguments = TypeVarTuple("Arguments")


@dataclass(frozen=True)
class StepRun:
    """Executor of steps.

    Attributes:
        job: The run, or the chapter.
        store: Checkpoints of the group, or of the scene that all chapters share.
        span: Frames of the group; None for the scene.
        sinks: Functions that write the results of steps, by the names of the steps.
    """

    job: Job
    store: GroupStore
    span: GroupSpan | None = None
    sinks: Mapping[str, Callable[[Any], None]] = field(default_factory=dict)

    @property
    def progress(self) -> Progress:
        """Display of the progress."""
        return self.job.progress

    def __call__(self, step: str, compute: Callable[[*Arguments], Found], *arguments: *Arguments) -> Found:
        """Return the result of a step: load it, or compute, save and report it.

        Args:
            step: Name of the step in `STEPS`.
            compute: Returns the result.
            arguments: Arguments of `compute`.
        """
        about = STEPS[step]
        with self.job.timed(about.timing):
            found = about.checkpoint and about.checkpoint.load(self.store)
            return self._execute(step, compute, *arguments) if found is None else found

    def _execute(self, step: str, compute: Callable[[*Arguments], Found], *arguments: *Arguments) -> Found:
        about, frames = STEPS[step], 1 if self.span is None else self.span.count
        steps = about.steps(self.job.config, frames)
        if about.text:
            self.job.show(step, steps, self.span)
        found = compute(*arguments)
        if about.checkpoint is not None:
            about.checkpoint.save(self.store, found)
        if step in self.sinks:
            self.sinks[step](found)
        if about.numbers is not None:
            self.progress.update(steps, **about.numbers(found, *arguments))
        return found
