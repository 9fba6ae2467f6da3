"""Measure the speedup of workers and threads for a video of chapters.

python benchmarks/chapters.py CAPTURE --width 240

Every job runs in a process of its own, from copies of one scene. Beside seconds there is processor time, which tells more where the
machine is not idle: of the main thread, and of all. What the main thread has more than the others with it is what threads do not
gain; SERIAL_SCENE and SERIAL_CHAPTER in run/estimate.py are this measurement's.
"""

import math
import multiprocessing
import shutil
import time
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import tyro

from record import machine, record
from splatreel.base import threads
from splatreel.base.process import keep_freed_memory, peak_memory_bytes, quiet_threads
from splatreel.cli.options import parse_frames
from splatreel.config import Quality, preset
from splatreel.config.settings import changed
from splatreel.run.estimate import SERIAL_SCENE, chapters_time, divide, job_time

MACHINES = {"16 cores": (16, 1), "8 x 16 cores": (16, 8)}
"""Cores of each, and how many."""
CHAPTERS, CHAPTER_FRAMES = 20, 300
"""Of the video that the model is asked about."""
SCENE, FINISH = "scene", "finish"
Row = dict[str, Any]


def work(connection: Connection, capture: Path, options: Row, settings: Row, out: Path, count: int, jobs: list) -> None:
    """Run jobs one after the other in this process. A job is a chapter or one of the names above."""
    quiet_threads()
    threads.use(count)
    keep_freed_memory()
    from splatreel.base.progress import Silent
    from splatreel.capture.opening import open_capture
    from splatreel.run.jobs import chapter_job, reel_job, scene_job
    from splatreel.run.output.group_writer import no_presentation
    from splatreel.run.pipeline import RunSpec

    config = changed(preset(settings["quality"]), settings["set"])
    with RunSpec(partial(open_capture, capture, **options), out, config, device="cpu").opened() as run:
        rows = []
        for job in jobs:
            main, all_threads, wall = time.thread_time(), time.process_time(), time.monotonic()
            if job == SCENE:
                scene_job(run, Silent())
            elif job == FINISH:
                reel_job(run, Silent(), no_presentation)
            else:
                chapter_job(run, job, Silent())
            found = {
                "seconds": time.monotonic() - wall,
                "processor": time.process_time() - all_threads,
                "main_thread": time.thread_time() - main,
            }
            rows.append({"job": job, "threads": count, **{name: round(value, 2) for name, value in found.items()}})
    connection.send((rows, peak_memory_bytes()))


def at_once(common: tuple, *tasks: tuple[Path, int, list]) -> tuple[list[Row], float, list[int]]:
    """Run processes side by side, and return the figures of their jobs, the total time and each process's memory."""
    context, started, running = multiprocessing.get_context("spawn"), time.monotonic(), []
    for task in tasks:
        mine, theirs = context.Pipe()
        process = context.Process(target=work, args=(theirs, *common, *task))
        process.start()
        theirs.close()
        running.append((mine, process))
    answers = [mine.recv() for mine, _ in running]
    for _, process in running:
        process.join()
    return [row for rows, _ in answers for row in rows], time.monotonic() - started, [peak for _, peak in answers]


def serial_share(one: Row, two: Row) -> float:
    """Return the processor time that one thread spends while the others wait.

    This is the main thread's time on two threads, less its share of the parallel work. Decoding ahead runs on other threads.
    """
    apart = two["processor"] * (1 - one["main_thread"] / one["processor"])
    shared = max(two["processor"] - two["main_thread"] - apart, 0.0)
    return round(max(two["main_thread"] - shared, 0.0) / two["processor"], 3)


def main(
    capture: tyro.conf.Positional[Path],
    /,
    width: int = 240,
    frames: str = "0:60",
    chapter_frames: int = 30,
    group: int = 30,
    quality: Quality = "standard",
    out: Path = Path("out/benchmark-chapters"),
    note: str = "",
) -> None:
    """Reconstruct two chapters in both ways, print, record."""
    shutil.rmtree(out, ignore_errors=True)
    settings = {
        "quality": quality,
        "set": {"chapter_frames": chapter_frames, "group.length": group, "check_coverage": False},
    }
    common = capture, {"width": width, "frames": parse_frames(frames)}, settings
    before = machine()
    (scene_two,), _, _ = at_once(common, (out / "scene", 2, [SCENE]))
    for copy in ("one", "two"):
        shutil.copytree(out / "scene", out / copy)
    (scene_one,), _, _ = at_once(common, (out / "again", 1, [SCENE]))
    first, second = (shutil.copytree(out / "scene", out / f"two-{number}") for number in range(2))
    two_rows, two_seconds, two_memory = at_once(common, (first, 1, [0]), (second, 1, [1]))
    one_rows, one_seconds, one_memory = at_once(common, (out / "one", 2, [0, 1, FINISH]))
    *one_rows, finish = one_rows
    for row in (scene_two, scene_one, *two_rows, *one_rows, finish):
        print(row)
    values = {
        "width": width,
        "frames": frames,
        "one_worker": {
            "seconds": round(one_seconds, 1),
            "processor": total(one_rows),
            "memory_mb": megabytes(one_memory),
        },
        "two_workers": {
            "seconds": round(two_seconds, 1),
            "processor": total(two_rows),
            "memory_mb": megabytes(two_memory),
        },
        "processor_ratio": round(total(two_rows) / total(one_rows), 3),
        "serial_scene": serial_share(scene_one, scene_two),
        "serial_chapters": [serial_share(a, b) for a, b in zip(two_rows, one_rows, strict=True)],
        "jobs": [scene_one, scene_two, *two_rows, *one_rows, finish],
        "modelled": modelled(scene_one, two_rows, finish, chapter_frames),
        "machine_before": before,
    }
    print(values)
    record("chapters", values, note)


def run_time(scene: float, chapter: float, finish: float, chapters: int, cores: int, machines: int = 1) -> float:
    """Return the time of a whole run on machines that are divided alike.

    Args:
        scene: Time of the scene's job on one thread.
        chapter: Time of a chapter's job on one thread.
        finish: Time of the last job, which uses one thread.
        chapters: Number of chapters.
        cores: Number of cores of each machine.
        machines: Number of machines.
    """
    share = math.ceil(chapters / machines)
    return job_time(scene, SERIAL_SCENE, cores) + chapters_time(chapter, share, divide(cores, share)) + finish


def modelled(scene: Row, chapters: list[Row], finish: Row, frames: int) -> Row:
    """Return the modelled minutes of a video of CHAPTERS on more cores and machines.

    The model assumes that a chapter costs as much per frame as the measured ones.

    Args:
        frames: Frames of a measured chapter.
    """
    scale = CHAPTER_FRAMES / frames
    chapter = scale * sum(row["processor"] for row in chapters) / len(chapters)
    ends = finish["processor"] * scale * CHAPTERS / len(chapters)
    found: Row = {}
    for name, (cores, count) in {"1 core": (1, 1), **MACHINES}.items():
        seconds = run_time(scene["processor"], chapter, ends, CHAPTERS, cores, count)
        division = divide(cores, -(-CHAPTERS // count))
        found[name] = {"minutes": round(seconds / 60, 1), "workers": division.workers, "threads": division.threads}
    return found


def total(rows: list[Row]) -> float:
    return round(sum(row["processor"] for row in rows), 2)


def megabytes(peaks: list[int]) -> list[int]:
    return [round(peak / 1e6) for peak in peaks]


if __name__ == "__main__":
    tyro.cli(main)
