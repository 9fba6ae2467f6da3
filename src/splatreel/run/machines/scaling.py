"""Model of how jobs share cores: the gain of threads, from a few measured numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

SERIAL_SCENE, SERIAL_CHAPTER, SERIAL_FINISH = 0.30, 0.28, 1.0
"""Share of the processor time of a job that only one thread can do. It was measured by `benchmarks/chapters.py`, on basketball 240
pixels wide with two threads, as the time that the main thread takes longer. Three runs gave 0.22 to 0.30 for the scene, 0.24 to
0.29 for chapters."""
WORTH = 1.15
"""Factor by which more workers must be faster to be used. Each worker holds a group's frames, and with fewer workers the first
chapter can be played sooner."""


@dataclass(frozen=True)
class Division:
    """Division of the cores of a machine.

    Attributes:
        workers: Number of chapters at a time.
        threads: Number of threads of each.
    """

    workers: int
    threads: int


def divide(cores: int, chapters: int, most: int | None = None) -> Division:
    """Return the division with the fewest workers that is about as fast as any other.

    Args:
        cores: Number of cores.
        chapters: Number of chapters.
        most: Largest number of workers, such as by memory; None for no limit.
    """
    choices = [Division(w, cores // w) for w in range(1, max(1, min(cores, chapters, most or cores)) + 1)]
    times = [chapters_time(1.0, chapters, choice) for choice in choices]
    return next(choice for choice, time in zip(choices, times, strict=True) if time <= WORTH * min(times))


def job_time(one_thread: float, serial: float, threads: int) -> float:
    """Return the time of a job on several threads (Amdahl's law).

    Args:
        one_thread: Time of the job on one thread.
        serial: Share of the work that only one thread can do.
        threads: Number of threads.
    """
    return one_thread * (serial + (1 - serial) / threads)


def chapters_time(one_thread: float, chapters: int, division: Division, machines: int = 1) -> float:
    """Return the time of chapters on machines that are divided alike. `one_thread` is the time of a chapter on one thread."""
    rounds = math.ceil(chapters / (division.workers * machines))
    return rounds * job_time(one_thread, SERIAL_CHAPTER, division.threads)


def run_time(scene: float, chapter: float, finish: float, chapters: int, cores: int, machines: int = 1) -> float:
    """Return the time of a whole run.

    Args:
        scene: Time of the scene's job on one thread.
        chapter: Time of a chapter's job on one thread.
        finish: Time of the last job on one thread.
        chapters: Number of chapters.
        cores: Number of cores of each machine.
        machines: Number of machines.
    """
    division = divide(cores, math.ceil(chapters / machines))
    before, after = job_time(scene, SERIAL_SCENE, cores), job_time(finish, SERIAL_FINISH, cores)
    return before + chapters_time(chapter, chapters, division, machines) + after
