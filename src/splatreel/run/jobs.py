"""The jobs that make a video of several chapters: the shared scene, each chapter, and the reel.

A job reads and writes files in one output folder, and holds a lock on its part of the folder. It skips finished work. A job
can therefore be repeated, continued, or run on another machine. The scene comes first, then the chapters in any order, then the reel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import ReconstructionError
from splatreel.base.progress import Progress
from splatreel.capture.base import Capture
from splatreel.capture.frame_table import load_tables, pack_tables
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.method.algorithm import ChapterStart
from splatreel.run.costs import Workload, chapter_plan, scene_plan, sequence_plan
from splatreel.run.groups import reconstruct_groups
from splatreel.run.job import Job, Plan
from splatreel.run.output.group_output import ChapterOutput, ignore_group
from splatreel.run.output.group_writer import GroupWriter, PresentationHook, open_writer
from splatreel.run.output.sound_output import select_soundtrack
from splatreel.run.run_folder import RunLock, run_record
from splatreel.run.run_logs import LoggedProgress, logged
from splatreel.run.shared_scene import load_plates, reconstruct_shared_scene, shared_rig
from splatreel.run.store import Store
from splatreel.scene.gaussians import StaticPoints
from splatreel.scene.group import ChapterSpan, GroupSpan, chapter_spans, group_spans

SCENE = "scene"
"""Name of the scene's job in files and locks."""
SCENE_FILES = ("run", "layout", "points", "header", "coverage", "chapters.json", "sound", "frames")
"""Beginnings of the names of the files that the scene's job writes beside the folders of groups."""
NAMED_CHAPTERS = 5
"""Number of unfinished chapters that an error names."""


@dataclass(frozen=True)
class ChapteredRun:
    """A reconstruction: the capture, the output folder and the settings.

    Attributes:
        capture: The capture at the size that is trained on.
        out: Output folder, which gets the folders reel and work.
        sound: The soundtrack, as `reconstruct` takes it.
        gpu: GPU that runs iterations of training; None runs them on the CPU.
        gpu_note: Why a GPU of this machine is not used; empty if there is nothing to say.
    """

    capture: Capture
    out: Path
    config: Config
    sound: str
    gpu: SharedGpu | None = None
    gpu_note: str = ""

    @property
    def device_name(self) -> str:
        """Device that trains: cpu, cuda or gpu."""
        return "cpu" if self.gpu is None else self.gpu.kind

    @property
    def store(self) -> Store:
        """Checkpoints of the run."""
        return Store(self.out / "work")

    @cached_property
    def groups(self) -> list[GroupSpan]:
        """All groups of the video."""
        group = self.config.group
        return group_spans(self.capture.frames, group.length, group.overlap)

    @cached_property
    def chapters(self) -> list[ChapterSpan]:
        """All chapters of the video, at least one."""
        subject_only = bool(self.capture.backgrounds)  # chapters share what always rests, and a subject moves
        return chapter_spans(self.groups, 0 if subject_only else self.config.chapter_frames)

    @cached_property
    def record(self) -> dict[str, Any]:
        """Everything that decides the result."""
        return run_record(self.capture, self.config, self.sound)

    @cached_property
    def workload(self) -> Workload:
        """Properties of the capture that decide how long the steps take."""
        return Workload.of(self.capture)

    def lock(self) -> RunLock:
        """Return the lock on the reel. For a video of one chapter it is the lock on the whole output folder."""
        reel = self.out / "reel"
        folders = (reel, *(place for place in reel.rglob("*") if place.is_dir()))
        own = None if len(self.chapters) == 1 else [(folder, "") for folder in folders]
        return RunLock(self.out, self.record, "", own)

    def lock_scene(self) -> RunLock:
        """Return the lock on the files of the shared scene."""
        names = (*SCENE_FILES, f"seconds-{SCENE}")
        own = [(self.store.scene.folder, ""), *((self.store.work, name) for name in names)]
        return RunLock(self.out, self.record, SCENE, own)

    def lock_chapter(self, chapter: ChapterSpan) -> RunLock:
        """Return the lock on the files of a chapter."""
        part = chapter_name(chapter.index)
        own = [(self.store.group(span.index).folder, "") for span in chapter.groups]
        own.append((self.store.work, f"seconds-{part}"))
        return RunLock(self.out, self.record, part, own)

    def job(self, progress: Progress, plan: Plan, part: str = "") -> Job:
        """Return what all stages of a part of the run share."""
        return Job(self.config, progress, self.store, plan, part, len(self.groups), self.gpu)

    def sequence_plan(self) -> Plan:
        """Return the plan of a video of one chapter."""
        return sequence_plan(self.workload, self.groups, self.config)

    def scene_plan(self) -> Plan:
        """Return the plan of the shared scene."""
        return scene_plan(self.workload, self.config)

    def chapter_plan(self, chapter: ChapterSpan) -> Plan:
        """Return the plan of a chapter."""
        return chapter_plan(self.workload, chapter.groups, self.config)

    def costs(self) -> list[float]:
        """Return the expected seconds of the scene and of each chapter."""
        return [self.scene_plan().total, *(self.chapter_plan(chapter).total for chapter in self.chapters)]


def chapter_name(chapter: int) -> str:
    """Return the name of a chapter in files and locks."""
    return f"chapter{chapter:04d}"


def has_scene(run: ChapteredRun) -> bool:
    """Return True if the shared scene is finished."""
    return run.store.scene.has_layer()


def has_chapter(run: ChapteredRun, chapter: ChapterSpan) -> bool:
    """Return True if all groups of a chapter are encoded."""
    return all(run.store.group(span.index).has_encoded_group() for span in chapter.groups)


def scene_job(run: ChapteredRun, progress: Progress) -> None:
    """Reconstruct the scene that all chapters share, from frames of the whole video.

    Raises:
        ReconstructionError: As `pipeline.reconstruct` raises it.
    """
    with run.lock_scene() as lock:
        save_frame_tables(run)
        if has_scene(run):
            return
        with logged(lock.work, SCENE) as log:
            progress = LoggedProgress(progress, log)
            job = run.job(progress, run.scene_plan(), SCENE)
            sound = select_soundtrack(lock.work, run.capture, run.sound, progress)
            run.store.save_chapter_firsts([chapter.first for chapter in run.chapters])
            reconstruct_shared_scene(job, run.capture, sound, lock)


def save_frame_tables(run: ChapteredRun) -> None:
    """Save the frame tables of the videos, unless they are saved, for all processes that open the capture later."""
    tables, file = run.capture.frame_tables(), run.store.tables_file
    if tables and load_tables(file).keys() != tables.keys():
        write_bytes(file, pack_tables(tables))


def chapter_job(
    run: ChapteredRun, index: int, progress: Progress, after_group: Callable[[int], None] = ignore_group
) -> None:
    """Reconstruct one chapter, group after group.

    Args:
        run: The run.
        index: Number of the chapter.
        progress: Display of the progress.
        after_group: Called with the index of each finished group.

    Raises:
        ReconstructionError: The shared scene is not finished, or as `pipeline.reconstruct` raises it.
    """
    chapter = run.chapters[index]
    with run.lock_chapter(chapter):
        if has_chapter(run, chapter):
            return
        with logged(run.store.work, chapter_name(index)) as log:
            if not has_scene(run):
                raise _scene_is_missing(run)

            def report_group(group: int) -> None:
                log.write(f"group {group + 1}/{len(run.groups)} is kept")
                after_group(group)

            job = run.job(LoggedProgress(progress, log), run.chapter_plan(chapter), chapter_name(index))
            output = ChapterOutput(run.store, run.store.header()[0], run.config.encode, report_group)
            _reconstruct_chapter(run, chapter, job, output)


def _reconstruct_chapter(run: ChapteredRun, chapter: ChapterSpan, job: Job, output: ChapterOutput) -> None:
    """Reconstruct the groups of a chapter, starting from the shared scene."""
    store = run.store
    shared, plates, layout = store.scene.layer(), load_plates(store.scene), store.layout()
    if shared is None or plates is None or layout is None:
        raise _scene_is_missing(run)
    static = StaticPoints.none(run.config.keyframe.sh_degree).with_layer(shared.decoded)
    before = ChapterStart(shared_rig(job, run.capture), static)
    reconstruct_groups(job, list(chapter.groups), run.capture, layout, before, output, plates.images)


def reel_job(run: ChapteredRun, progress: Progress, present: PresentationHook) -> None:
    """Write the reel from all chapters.

    Raises:
        ReconstructionError: A chapter is not finished. The error names it.
    """
    with run.lock():
        reel = ChapterReelWriter(run, present)
        reel.write_ready()
        missing = [chapter.index for chapter in run.chapters if not has_chapter(run, chapter)]
        if missing:
            named = ", ".join(str(index + 1) for index in missing[:NAMED_CHAPTERS])
            more = " ..." if len(missing) > NAMED_CHAPTERS else ""
            raise ReconstructionError(
                f"{run.out}: {len(missing)} of {len(run.chapters)} chapters are not finished ({named}{more}). The reel has the groups "
                "before them. Run these chapters again, then run this job again."
            )
        reel.finish()


class ChapterReelWriter:
    """Writes encoded groups of chapters into the reel, in order. The run must be locked.

    Raises:
        ReconstructionError: The shared scene is not finished.
    """

    def __init__(self, run: ChapteredRun, present: PresentationHook) -> None:
        if not has_scene(run):
            raise _scene_is_missing(run)
        self.run = run
        self.present = present
        self.writer: ReelWriter = open_writer(run.store, run.out / "reel", run.config.encode, resume=True)
        self._group_writer = GroupWriter(self.writer, run.store, encoded=True)
        self.written = self.writer.manifest.end_group
        for index in range(self.written):
            self._group_writer.skip(index)
        if self.written:
            present(self.writer, self.written - 1)

    def write_ready(self) -> None:
        """Write all encoded groups up to the first that is missing."""
        store, count = self.run.store, len(self.run.groups)
        while self.written < count and store.group(self.written).has_encoded_group():
            self._group_writer.write(self.written)
            self.present(self.writer, self.written)
            self.written += 1

    def finish(self) -> None:
        """Declare the reel complete."""
        self.present(self.writer, None)
        self.writer.finish()


def _scene_is_missing(run: ChapteredRun) -> ReconstructionError:
    return ReconstructionError(f"{run.out}: the scene that chapters share is not finished. Run the scene's job first.")
