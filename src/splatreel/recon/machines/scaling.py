"""How jobs share cores: a model of what threads gain, with the few numbers that were measured for it."""

from __future__ import annotations

import math
from dataclasses import dataclass

SERIAL_SCENE, SERIAL_CHAPTER, SERIAL_FINISH = 0.30, 0.28, 1.0
"""Of the processor time of a job, the share that one thread alone can do, so that the others wait for it: measured by
`benchmarks/chapters.py`, basketball 240 pixels wide, as what the main thread takes more than the other one of two. Three runs gave
0.22 to 0.30 for the scene, 0.24 to 0.29 for chapters."""
WORTH = 1.15
"""More workers are taken only where they are faster than this: each holds a group's frames of its own, and the fewer there are, the
sooner the first chapter can be played."""


@dataclass(frozen=True)
class Division:
    """How chapters share the cores of a machine. workers: chapters at a time; threads: of each."""

    workers: int
    threads: int


def divide(cores: int, chapters: int, most: int | None = None) -> Division:
    """The fewest workers that are about as quick as any other number of them. most: workers that are possible, such as by memory."""
    choices = [Division(w, cores // w) for w in range(1, max(1, min(cores, chapters, most or cores)) + 1)]
    times = [chapters_time(1.0, chapters, choice) for choice in choices]
    return next(choice for choice, time in zip(choices, times, strict=True) if time <= WORTH * min(times))


def job_time(one_thread: float, serial: float, threads: int) -> float:
    """What a job takes on so many threads (Amdahl's law). one_thread: what it takes on one; serial: one of the shares above."""
    return one_thread * (serial + (1 - serial) / threads)


def chapters_time(one_thread: float, chapters: int, division: Division, machines: int = 1) -> float:
    """What so many chapters take, each of which takes `one_thread` on one thread, on machines that are divided alike."""
    rounds = math.ceil(chapters / (division.workers * machines))
    return rounds * job_time(one_thread, SERIAL_CHAPTER, division.threads)


def run_time(scene: float, chapter: float, finish: float, chapters: int, cores: int, machines: int = 1) -> float:
    """What a whole run takes. scene, chapter, finish: what each of these jobs takes on one thread."""
    division = divide(cores, math.ceil(chapters / machines))
    before, after = job_time(scene, SERIAL_SCENE, cores), job_time(finish, SERIAL_FINISH, cores)
    return before + chapters_time(chapter, chapters, division, machines) + after
