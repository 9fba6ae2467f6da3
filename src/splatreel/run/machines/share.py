"""The chapters that one task of a batch system makes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from splatreel.base.errors import UsageError

JobName = Literal["scene", "chapter", "finish"]


@dataclass(frozen=True)
class Share:
    """One of several equal shares of the chapters: those whose number divided by `tasks` leaves the remainder `index`."""

    index: int
    tasks: int

    def of(self, chapters: int) -> range:
        """Return the chapters of the share."""
        return range(self.index, chapters, self.tasks)


def parse_share(text: str) -> Share:
    """Return the share that a text such as `2/8` names, the third of eight.

    Raises:
        UsageError: The text names no share.
    """
    match = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text.strip())
    if match is None or int(match[1]) >= int(match[2]):
        raise UsageError(
            f"--chapter {text!r:.60} is not a share of the chapters. Write I/N for task I of N, counted from 0, such as 0/8."
        )
    return Share(int(match[1]), int(match[2]))


def share_of_task(variables: Mapping[str, str]) -> Share:
    """Return the share of a task of a Slurm job array, from its environment variables.

    Raises:
        UsageError: The process is not such a task.
    """
    names = ("SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_COUNT")
    missing = [name for name in names if not variables.get(name, "").isdecimal()]
    if missing:
        raise UsageError(
            f"--job chapter: its chapters are unknown. Give --chapter I/N, or start a Slurm array task, which sets {missing[0]}."
        )
    task, first, tasks = (int(variables[name]) for name in names)
    step = max(int(variables.get("SLURM_ARRAY_TASK_STEP") or 1), 1)
    index, rest = divmod(task - first, step)
    if rest or not 0 <= index < tasks:
        raise UsageError(
            f"--job chapter: SLURM_ARRAY_TASK_ID {task} is not one of {tasks} tasks from {first} in steps of {step}. "
            "Give --chapter I/N."
        )
    return Share(index, tasks)
