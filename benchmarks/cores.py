"""Run a `splatreel` command and write the serial and the parallel processor time of each stage, with a model of more cores.

python benchmarks/cores.py OUT/cores.md reconstruct CAPTURE --out OUT --threads 1

All numbers are processor time of threads, which other programs on the machine hardly change. Work is parallel if it runs within
`threads.run_ranges` (which `map_parallel` and `Kernel.over` call), and serial otherwise. A parallel region takes as long as its items
take on n cores, each item on the first core that is free. It cannot be shorter than its longest item. Regions within items are
computed with the share of the cores that the item has. The model knows neither memory bandwidth, nor waiting for a GPU or a disk, nor
the interpreter lock, which items hold outside of compiled code.
"""

from __future__ import annotations

import heapq
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base import threads
from splatreel.cli.main import main
from splatreel.evaluation.report import write_text
from splatreel.run.job import Job

SHOWN = (1, 2, 8, 16)
"""Numbers of cores in the table."""
MOST = max(SHOWN)
OUTSIDE, OTHER = "outside of stages", "other threads"


@dataclass
class Work:
    """Processor time of one thread, and of the regions that it starts.

    Attributes:
        serial: Seconds outside of regions.
        parallel: Seconds within regions, of all threads.
        regions: Seconds [MOST + 1] that the regions take, by the number of cores.
        inner: Seconds that this thread itself spent in items of the regions.
    """

    serial: float = 0.0
    parallel: float = 0.0
    regions: np.ndarray = field(default_factory=lambda: np.zeros(MOST + 1))
    inner: float = 0.0

    def on(self, cores: int) -> float:
        """Return the seconds on a number of cores."""
        return self.serial + float(self.regions[cores])

    def add(self, region: Region) -> None:
        """Add a region, after its end."""
        self.parallel += sum(item.serial + item.parallel for item in region.items)
        self.regions += region.seconds()


@dataclass
class Region:
    """Items that run in parallel.

    Attributes:
        ranges: Maximum number of parts into which the items can be divided evenly; 0 if each item is one part, as items that start
            regions are in any case.
    """

    ranges: int = 0
    items: list[Work] = field(default_factory=list)

    def seconds(self) -> np.ndarray:
        """Return the seconds [MOST + 1] on each number of cores."""
        return np.array([0.0, *(self._on(cores) for cores in range(1, MOST + 1))])

    def _on(self, cores: int) -> float:
        if self.ranges and not any(item.parallel for item in self.items):
            return sum(item.on(1) for item in self.items) / min(cores, self.ranges)
        free = [0.0] * min(cores, len(self.items))
        for place, item in enumerate(self.items):
            share = max(1, cores // min(cores, len(self.items) - place))
            heapq.heappush(free, heapq.heappop(free) + item.on(share))
        return max(free, default=0.0)


class CoreMeter:
    """Measurement of stages. `measuring` installs it.

    Attributes:
        stages: Work by stage, in the order in which stages began.
    """

    def __init__(self) -> None:
        self.stages: dict[str, Work] = {}
        self._stack = threading.local()
        self._lock = threading.Lock()
        self._run_ranges = threads.run_ranges

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the work of the calling thread in the block to a stage."""
        work, start = Work(), time.thread_time()
        stack = self._works()
        stack.append(work)
        try:
            yield
        finally:
            stack.pop()
            elapsed = time.thread_time() - start
            work.serial += elapsed - work.inner
            if stack:
                stack[-1].inner += elapsed
            self._add_to_stage(name, work)

    def run_ranges(
        self,
        function: Callable[..., Any],
        items: int,
        arguments: tuple[Any, ...],
        grain: int = 1,
        chunks: int | None = None,
    ) -> None:
        """See `threads.run_ranges`. Ranges are run even on one thread if their number does not depend on the threads."""
        own = chunks == items  # one part an item
        region = Region(0 if own else max(1, items // grain))
        places: list[tuple[int, Work]] = []

        def measured(first: int, last: int, *given: Any) -> None:
            work, stack, start = Work(), self._works(), time.thread_time()
            stack.append(work)
            try:
                function(first, last, *given)
            finally:
                stack.pop()
                elapsed = time.thread_time() - start
                work.serial = elapsed - work.inner
                if stack:
                    stack[-1].inner += elapsed
                places.append((first, work))

        if own and threads.count() == 1:
            for place in range(items):
                measured(place, place + 1, *arguments)
        else:
            self._run_ranges(measured, items, arguments, grain, chunks)
        region.items += [work for _, work in sorted(places, key=lambda place: place[0])]
        stack = self._works()
        if stack:
            stack[-1].add(region)
        else:
            work = Work()
            work.add(region)
            self._add_to_stage(OTHER, work)

    def report(self, whole: float) -> str:
        """Return a Markdown table. `whole`: processor time of the process, of which work that no stage knows is the last row."""
        rows = [*self.stages.items()]
        known = sum(work.serial + work.parallel for _, work in rows)
        total = Work()
        for _, work in rows:
            total.serial, total.parallel = total.serial + work.serial, total.parallel + work.parallel
            total.regions += work.regions
        heads = " | ".join(f"{cores} core{'s'[: cores > 1]}, s" for cores in SHOWN)
        lines = [f"| stage | serial, s | parallel, s | {heads} |", "|---" * (3 + len(SHOWN)) + "|"]
        for name, work in [*rows, ("all stages", total)]:
            times = " | ".join(f"{work.on(cores):.2f}" for cores in SHOWN)
            lines.append(f"| {name} | {work.serial:.2f} | {work.parallel:.2f} | {times} |")
        lines.append(
            f"| other threads and libraries | {max(whole - known, 0.0):.2f} | | {' | '.join([''] * len(SHOWN))} |"
        )
        return "\n".join([*lines, ""])

    def _works(self) -> list[Work]:
        if not hasattr(self._stack, "works"):
            self._stack.works = []
        return self._stack.works

    def _add_to_stage(self, name: str, work: Work) -> None:
        with self._lock:
            stage = self.stages.setdefault(name, Work())
            stage.serial += work.serial
            stage.parallel += work.parallel
            stage.regions += work.regions


@contextmanager
def measuring(path: Path) -> Iterator[CoreMeter]:
    """Measure stages inside the `with` block and write the table to a file, also after an exception."""
    meter, timed, begin = CoreMeter(), Job.timed, time.process_time()

    @contextmanager
    def timed_stage(job: Job, stage: str) -> Iterator[None]:
        with timed(job, stage), meter.stage(stage):
            yield

    threads.run_ranges = meter.run_ranges
    Job.timed = timed_stage  # pyright: ignore[reportAttributeAccessIssue]
    try:
        with meter.stage(OUTSIDE):
            yield meter
    finally:
        threads.run_ranges, Job.timed = meter._run_ranges, timed
        if path.parent.is_dir():  # otherwise the run never started
            write_text(path, meter.report(time.process_time() - begin))


if __name__ == "__main__":
    with measuring(Path(sys.argv[1])):
        status = main(sys.argv[2:])
    sys.exit(status)
