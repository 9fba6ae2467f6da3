"""Which chapters a task of a batch system makes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from splatreel.errors import UsageError

JobName = Literal["scene", "chapter", "finish"]


@dataclass(frozen=True)
class Share:
    """Which chapters a task makes: those whose number leaves this remainder when it is divided by the number of tasks."""

    index: int
    tasks: int

    def of(self, chapters: int) -> range:
        return range(self.index, chapters, self.tasks)


def parse_share(text: str) -> Share:
    """`2/8`, the third of eight tasks. Raises `UsageError` for anything else."""
    match = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text.strip())
    if match is None or int(match[1]) >= int(match[2]):
        raise UsageError(
            f"--chapter {text!r:.60} is no share of the chapters. Write I/N for task I of N, counted from 0, such as 0/8."
        )
    return Share(int(match[1]), int(match[2]))


def share_of_task(variables: Mapping[str, str]) -> Share:
    """That of a task of one of Slurm's job arrays, by its environment variables. Raises `UsageError` where there is none."""
    names = ("SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_COUNT")
    missing = [name for name in names if not variables.get(name, "").isdecimal()]
    if missing:
        raise UsageError(
            f"--job chapter: which chapters? Give --chapter I/N, or start it as a task of an array of Slurm, which sets {missing[0]}."
        )
    task, first, tasks = (int(variables[name]) for name in names)
    step = max(int(variables.get("SLURM_ARRAY_TASK_STEP") or 1), 1)
    index, rest = divmod(task - first, step)
    if rest or not 0 <= index < tasks:
        raise UsageError(
            f"--job chapter: SLURM_ARRAY_TASK_ID {task} is none of {tasks} tasks from {first} on, {step} apart. Give --chapter I/N."
        )
    return Share(index, tasks)
