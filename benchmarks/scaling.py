"""Growth of a reconstruction's time and memory with pixels, cameras, threads, workers and frames, one at a time.

python benchmarks/scaling.py                         films, measures and records what is not recorded yet
python benchmarks/scaling.py --only pixels,frames    these only
python benchmarks/scaling.py --show                  writes docs/scaling.md and its plot from what is recorded

The kitchen is filmed by more or fewer cameras on the same stretch, and all of them are trained on. Each case is reconstructed in a
process of its own, so that its peak of memory is its own. A case that was cut off starts anew; one that is recorded, of the same source
and with the same note, is not measured again.
"""

import dataclasses
import json
import multiprocessing
import os
import shutil
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

import scaling_page
from record import RESULTS, machine, record, source
from resident import Resident
from splatreel.base import threads
from splatreel.base.errors import SplatreelError
from splatreel.base.process import keep_freed_memory, quiet_threads
from splatreel.config import preset
from splatreel.config.settings import changed

if TYPE_CHECKING:
    from splatreel.run.store import Store

Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One measured reconstruction. axis: the quantity that varies. width: pixels, 4/3 of the height. frames: number of first frames.

    workers: processes, one thread each where they are several. settings: that differ from draft.
    """

    axis: str
    width: int
    cameras: int
    frames: int
    threads: int = 2
    workers: int = 1
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def height(self) -> int:
        return round(self.width * 3 / 4)

    @property
    def name(self) -> str:
        return f"scaling {self.axis} {scaling_page.value_of(self.axis, self.row())}"

    def row(self) -> Row:
        """Return the case as a record has it."""
        return dataclasses.asdict(self) | {"height": self.height}


@dataclass(frozen=True)
class Sizes:
    """The values of each axis. widths: of the axis of pixels, the first one also of the other axes but frames.

    filmed: frames of every axis but workers and frames. settings: of every case. long, long_width, long_cameras: of the axis of frames.
    chapter: frames of each of as many chapters as there are workers at most.
    """

    widths: tuple[int, ...] = (368, 728, 1352, 2576)
    cameras: tuple[int, ...] = (8, 18, 40)
    threads: tuple[int, ...] = (1, 2, 4)
    frames: tuple[int, ...] = (30, 300, 3000)
    filmed: int = 6
    chapter: int = 6
    long_width: int = 96
    long_cameras: int = 6
    settings: dict[str, Any] = field(default_factory=lambda: {"check_coverage": False})
    long: dict[str, Any] = field(
        default_factory=lambda: {
            "keyframe.first_iterations": 200,
            "keyframe.refine_iterations": 30,
            "group.iterations_per_frame": 2,
        }
    )

    def cases(self) -> list[Case]:
        """Return all cases, axis after axis, each from the smallest."""
        base = partial(Case, width=self.widths[0], cameras=self.cameras[0], frames=self.filmed, settings=self.settings)
        chapters = {"chapter_frames": self.chapter, "group.length": self.chapter, "group.overlap": 1}
        film = partial(base, frames=self.chapter * max(self.threads), settings=self.settings | chapters)
        long = partial(Case, "frames", self.long_width, self.long_cameras, settings=self.settings | self.long)
        return [
            *(base("pixels", width=width) for width in self.widths),
            *(base("cameras", cameras=count) for count in self.cameras),
            *(base("threads", threads=count) for count in self.threads),
            *(film("workers", workers=count, threads=count) for count in self.threads),
            *(long(frames=count) for count in self.frames),
        ]


TINY = Sizes(
    widths=(48, 64),
    cameras=(4, 6),
    threads=(1, 2),
    frames=(6, 12),
    filmed=3,
    chapter=3,
    long_width=64,
    long_cameras=4,
    settings={"check_coverage": False, "keyframe.first_iterations": 12, "group.iterations_per_frame": 2},
    long={"group.length": 3, "group.overlap": 1, "chapter_frames": 6},
)
"""To try the script."""
_WARM = partial(Case, "warm-up", 96, 6, 30)
_QUICK = TINY.settings | {"keyframe.refine_iterations": 5, "group.length": 10, "group.overlap": 2}
WARM = tuple(_WARM(settings=_QUICK | {"chapter_frames": frames}) for frames in (0, 10))
"""What is run first, for kernels to be compiled: a film of one chapter and one of three, with things that move."""


def main(
    only: str = "",
    show: bool = False,
    tiny: bool = False,
    out: Path = Path("out/scaling"),
    results: Path = RESULTS,
    note: str = "",
) -> None:
    """Measure and record, or show; ends with 1 if a case failed.

    only: axes, with commas: pixels, cameras, threads, workers, frames; all by default.
    show: measure nothing; write the page and its plot.
    tiny: try the script on tiny sizes; it needs --results, a file other than that of real measurements.
    out: films, which stay, and the runs.
    """
    axes = only.split(",") if only else list(scaling_page.AXES)
    if unknown := [axis for axis in axes if axis not in scaling_page.AXES]:
        fail(f"--only: there is no axis {unknown[0]!r}. Choose among {', '.join(scaling_page.AXES)}.")
    if tiny and results.resolve() == RESULTS:
        fail("--tiny measures nothing: name a file of its own, --results FILE.")
    if show:
        return scaling_page.write(scaling_page.records(results))
    cases = (TINY if tiny else Sizes()).cases()
    chosen = [case for case in cases if case.axis in axes]
    sys.exit(1 if Bench(out, results, note, longest(cases)).run(chosen) else 0)


def fail(text: str) -> None:
    print(text, file=sys.stderr)
    sys.exit(2)


def longest(cases: list[Case]) -> dict[tuple[int, int], int]:
    """Return the number of frames to film for each width and number of cameras. Several cases share a film."""
    found: dict[tuple[int, int], int] = {}
    for case in cases:
        found[case.width, case.cameras] = max(case.frames, found.get((case.width, case.cameras), 0))
    return found


def in_a_process(function: Callable[..., Any], *arguments: Any) -> Any:
    """Run a function in a new process that imports only this file, and return its result. Its exceptions are raised here."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


@dataclass
class Bench:
    """Folders of films and runs, and the recording of results. films: see `longest`. apart: calls each function separately."""

    out: Path
    results: Path
    note: str
    films: dict[tuple[int, int], int]
    apart: Callable[..., Any] = in_a_process
    warm: bool = False

    def run(self, cases: list[Case]) -> bool:
        """Measure and record the cases that are not recorded; return True if any failed."""
        failed = False
        for case in cases:
            if self.is_recorded(case):
                print(f"{case.name}: is recorded", flush=True)
                continue
            try:
                print(self.measured(case), flush=True)
            except (BrokenProcessPool, SplatreelError) as error:  # the first: it was killed, perhaps for its memory
                print(f"{case.name}: failed: {error}", file=sys.stderr, flush=True)
                failed = True
        return failed

    def is_recorded(self, case: Case) -> bool:
        """Return True if a record of this source with this note exists."""
        same = json.loads(json.dumps(case.row())) | {"benchmark": case.name, "note": self.note, "source": source()}
        rows = scaling_page.rows(self.results)
        return any(all(row.get(name) == value for name, value in same.items()) for row in rows)

    def measured(self, case: Case) -> Row:
        """Return the record of a case. Film it and compile the kernels first, if necessary."""
        film = self.film(case, self.films[case.width, case.cameras])
        self.warm_up()
        print(f"{case.name}: measuring", flush=True)
        label = {"source": source(), "machine_before": machine()}
        found = self.apart(measure, case, film, self.out / "run")
        return record(case.name, case.row() | label | found, self.note, self.results)

    def warm_up(self) -> None:
        """Compile the kernels once, so that no measurement includes it."""
        if not self.warm:
            print("compiling the kernels that are not compiled yet", flush=True)
            for case in WARM:
                self.apart(measure, case, self.film(case, case.frames), self.out / "run")
            self.warm = True

    def film(self, case: Case, frames: int) -> Path:
        """Return the path of the film."""
        path = self.out / f"film-{case.width}-{case.cameras}-{frames}"
        if not path.exists():
            print(f"filming {frames} frames of {case.width}x{case.height} by {case.cameras} cameras", flush=True)
            self.apart(write_film, path, case.width, case.cameras, frames)
        return path


def write_film(path: Path, width: int, cameras: int, frames: int) -> None:
    """Film the kitchen with this many cameras; none is held out."""
    import kitchen

    wall = kitchen.wall(width, round(width * 3 / 4), cameras // kitchen.ROWS)
    dataclasses.replace(kitchen.film(width), cameras=wall, held_out=()).write(path, frames)


def measure(case: Case, film: Path, out: Path) -> Row:
    """Reconstruct a case into OUT anew, and delete it; to be called in a process of its own.

    seconds: by stage, those of all workers together. seconds_wall: from the opening of the capture to the finished reel. processor:
    seconds of all threads and workers. memory_mb: the most that all its processes held together. memory_mb_by_group: the most within
    each group's time, where one process makes them all. More threads than cores are let pass, which `--threads` does not.
    """
    cores = threads.available()
    quiet_threads()
    if case.threads > cores:
        threads.available = lambda: case.threads
    threads.use(case.threads)
    keep_freed_memory()
    from splatreel.capture.opening import open_capture
    from splatreel.run.machines.local_processes import reconstruct_here
    from splatreel.run.pipeline import RunSpec
    from splatreel.run.store import Store

    shutil.rmtree(out, ignore_errors=True)
    opened = partial(open_capture, film, width=case.width, frames=(0, case.frames))
    spec = RunSpec(opened, out, changed(preset("draft"), case.settings), "none", "cpu")
    started, before = time.monotonic(), sum(os.times()[:4])
    with Resident(with_children=case.workers > 1) as resident:
        result = reconstruct_here(spec, workers=case.workers)
    wall, processor = time.monotonic() - started, sum(os.times()[:4]) - before
    found: Row = {
        "cores": cores,
        "seconds": result.seconds,
        "seconds_total": round(sum(result.seconds.values()), 2),
        "seconds_wall": round(wall, 2),
        "processor": round(processor, 2),
        "memory_mb": round(resident.peak() / 1e6, 1),
        "points": points(result.reel),
    }
    if case.workers == 1:
        found["memory_mb_by_group"] = [round(peak / 1e6, 1) for peak in resident.peaks(ends(Store(result.work)))]
    shutil.rmtree(out)
    return found


def points(reel: Path) -> int:
    """Return the number of points in the first group."""
    from splatreel.codec.reader import ReelReader

    manifest = ReelReader(reel).manifest
    return manifest.static_points(0) + manifest.groups[0].points


def ends(store: "Store") -> list[float]:
    """Return when each group was finished, in seconds since the epoch."""
    count = store.finished_groups()
    return [(store.group(index).folder / "group.safetensors").stat().st_mtime for index in range(count)]


if __name__ == "__main__":
    tyro.cli(main)
