"""The jobs that a video of several chapters is made by: the scene that they share, each chapter, the reel.

Each reads and writes files in one output folder, holds a lock on its part of it, and does only what is not done yet, so that it can
be repeated, continued, or run on another machine. The scene comes first, then the chapters in any order, then the reel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch

from splatreel.capture.base import Capture
from splatreel.capture.frame_table import load_tables, pack_tables
from splatreel.codec.container import write_atomically
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config
from splatreel.errors import ReconstructionError
from splatreel.progress import Progress
from splatreel.recon.encode.group_output import ChapterOutput, ignore_group
from splatreel.recon.encode.group_writer import GroupWriter, PresentationHook
from splatreel.recon.encode.header import open_writer
from splatreel.recon.encode.soundtrack import select_soundtrack
from splatreel.recon.groups import Handover, reconstruct_groups
from splatreel.recon.init.layout import Layout
from splatreel.recon.run.job import Job
from splatreel.recon.run.job_log import LoggedProgress, logged
from splatreel.recon.run.plan import Plan
from splatreel.recon.run.run_lock import RunLock
from splatreel.recon.run.store import Store
from splatreel.recon.shared_scene import reconstruct_shared_scene, shared_rig
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.spans import ChapterSpan, GroupSpan, chapter_spans, group_spans
from splatreel.scene.static_points import StaticPoints

SCENE = "scene"
SHARED = ("run", "layout", "points", "header", "coverage", "chapters.json", "sound", "frames")
"""How the names of the scene's files begin that lie beside the folders of groups."""
_PLATE = GroupSpan(0, 0, 1, 1)
"""The scene's pictures are one frame."""


@dataclass(frozen=True)
class ChapteredRun:
    """What is to be made, and where. sound: as in `reconstruct`."""

    capture: Capture
    out: Path
    config: Config
    sound: str
    device: torch.device

    @property
    def store(self) -> Store:
        return Store(self.out / "work")

    @cached_property
    def groups(self) -> list[GroupSpan]:
        group = self.config.group
        return group_spans(self.capture.frames, group.length, group.overlap)

    @cached_property
    def chapters(self) -> list[ChapterSpan]:
        return chapter_spans(self.groups, self.config.chapter_frames)

    def lock(self) -> RunLock:
        """The right to write the reel, and of a video of one chapter everything else."""
        reel = self.out / "reel"
        folders = (reel, *(place for place in reel.rglob("*") if place.is_dir()))
        own = None if len(self.chapters) == 1 else [(folder, "") for folder in folders]
        return RunLock(self.out, self.capture, self.config, self.sound, "", own)

    def lock_scene(self) -> RunLock:
        own = [(self.store.scene.folder, ""), *((self.store.work, name) for name in (*SHARED, f"seconds-{SCENE}"))]
        return RunLock(self.out, self.capture, self.config, self.sound, SCENE, own)

    def lock_chapter(self, chapter: ChapterSpan) -> RunLock:
        part = part_of(chapter.index)
        own = [(self.store.group(span.index).folder, "") for span in chapter.groups]
        return RunLock(
            self.out, self.capture, self.config, self.sound, part, [*own, (self.store.work, f"seconds-{part}")]
        )

    def job(self, part: str, spans: tuple[GroupSpan, ...], progress: Progress) -> Job:
        return Job(self.config, self.device, progress, self.store, list(spans), part, len(self.groups))

    def costs(self) -> list[float]:
        """What the scene and each chapter cost, in iterations of a keyframe."""
        parts = [(_PLATE,), *(chapter.groups for chapter in self.chapters)]
        return [Plan(spans, self.config).total for spans in parts]


def part_of(chapter: int) -> str:
    """The name of a chapter in files and locks."""
    return f"chapter{chapter:04d}"


def has_scene(run: ChapteredRun) -> bool:
    return run.store.scene.has_layer()


def has_chapter(run: ChapteredRun, chapter: ChapterSpan) -> bool:
    """Whether all its groups are encoded."""
    return all(run.store.group(span.index).has_encoded_group() for span in chapter.groups)


def scene_job(run: ChapteredRun, progress: Progress) -> None:
    """What is always there, reconstructed from the whole video. Raises as `reconstruct` does."""
    with run.lock_scene() as lock:
        keep_tables(run)
        if has_scene(run):
            return
        with logged(lock.work, SCENE) as log:
            progress = LoggedProgress(progress, log)
            job = run.job(SCENE, (_PLATE,), progress)
            sound = select_soundtrack(lock.work, run.capture, run.sound, progress)
            run.store.save_chapter_firsts([chapter.first for chapter in run.chapters])
            reconstruct_shared_scene(job, run.capture, sound, lock)


def keep_tables(run: ChapteredRun) -> None:
    """Write the frame tables of the run's videos, unless they are there, for all who open its capture after this."""
    tables, file = run.capture.frame_tables(), run.store.tables_file
    if tables and load_tables(file).keys() != tables.keys():
        write_atomically(file, pack_tables(tables))


def chapter_job(
    run: ChapteredRun, index: int, progress: Progress, after_group: Callable[[int], None] = ignore_group
) -> None:
    """One chapter, group after group. after_group: called with the index of each group when it is finished.

    Raises `ReconstructionError` where the scene is not there yet, and as `reconstruct` does.
    """
    chapter = run.chapters[index]
    with run.lock_chapter(chapter):
        if has_chapter(run, chapter):
            return
        with logged(run.store.work, part_of(index)) as log:

            def finished(group: int) -> None:
                log.write(f"group {group + 1}/{len(run.groups)} is kept")
                after_group(group)

            job = run.job(part_of(index), chapter.groups, LoggedProgress(progress, log))
            layout, before = _begin(run, job)
            output = ChapterOutput(run.store, run.store.header()[0], run.config.encode, finished)
            reconstruct_groups(job, run.capture, layout, before, output)


def publish_job(run: ChapteredRun, progress: Progress, present: PresentationHook) -> None:
    """The reel, from all chapters. Raises `ReconstructionError` where one is not finished, and says which."""
    with run.lock():
        publisher = ChapterPublisher(run, present)
        publisher.publish_ready()
        missing = [chapter.index for chapter in run.chapters if not has_chapter(run, chapter)]
        if missing:
            some = ", ".join(str(index + 1) for index in missing[:5]) + (" ..." if len(missing) > 5 else "")
            raise ReconstructionError(
                f"{run.out}: {len(missing)} of {len(run.chapters)} chapters are not finished ({some}). The reel has the groups before "
                "them. Run these chapters again, and then this."
            )
        publisher.finish()


class ChapterPublisher:
    """Puts the groups of chapters into the reel, in order, as far as they are there. The run is locked while it is used."""

    def __init__(self, run: ChapteredRun, present: PresentationHook) -> None:
        if not has_scene(run):
            raise ReconstructionError(f"{run.out}: the scene that chapters share is not finished. Make it first.")
        self.run, self.present = run, present
        self.writer: ReelWriter = open_writer(run.store, run.out / "reel", run.config.encode, resume=True)
        self._group_writer = GroupWriter(self.writer, run.store, run.device, encoded=True)
        self.published = self.writer.manifest.end_group
        for index in range(self.published):
            self._group_writer.skip(index)
        if self.published:
            present(self.writer, self.published - 1)

    def publish_ready(self) -> None:
        """All groups whose turn it is and that are encoded."""
        store, count = self.run.store, len(self.run.groups)
        while self.published < count and store.group(self.published).has_encoded_group():
            self._group_writer.write(self.published)
            self.present(self.writer, self.published)
            self.published += 1

    def finish(self) -> None:
        """Declare the reel complete."""
        self.present(self.writer, None)
        self.writer.finish()


def _begin(run: ChapteredRun, job: Job) -> tuple[Layout, Handover]:
    """The measures of the scene, and what a chapter starts from."""
    store = run.store
    shared, plates, layout = store.scene.layer(), store.scene.plates(), store.layout()
    if shared is None or plates is None or layout is None:
        raise ReconstructionError(f"{run.out}: the scene that chapters share is not finished. Make it first.")
    static = StaticPoints.none(run.config.keyframe.sh_degree).with_layer(shared.decoded)
    return layout, Handover(shared_rig(job, run.capture), static, Gaussians.empty(), plates=plates.images, begins=True)
