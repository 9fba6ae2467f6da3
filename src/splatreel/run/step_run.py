"""Execution of the steps of a group: their times, their progress, and their checkpoints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar, TypeVarTuple

from splatreel.base.progress import Progress
from splatreel.run.job import Job
from splatreel.run.steps import STEPS
from splatreel.run.store import GroupStore
from splatreel.scene.group import GroupSpan

Arguments = TypeVarTuple("Arguments")
Found = TypeVar("Found")


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
