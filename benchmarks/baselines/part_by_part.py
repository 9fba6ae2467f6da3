"""Baselines that train one part of the video after the other: the loop, its time, its checkpoints, and the reel at its end."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

from baselines.budget import Budget, Spent
from baselines.shared_start import SharedStart
from splatreel.base.atomic import move
from splatreel.base.errors import UsageError
from splatreel.base.progress import Progress
from splatreel.method.train.training_images import TrainingImages
from splatreel.run.store import load_arrays, load_json, pack, save_arrays, save_json, unpack
from splatreel.scene.gaussians import Gaussians

RECORD = "parts.json"
"""File with the cost of each finished part."""


class PartMethod(Protocol):
    """Method that trains parts of a video, each from the frame before it, and writes all frames as a reel."""

    def first(self, keyframe: Gaussians) -> Gaussians:
        """Return the points of the first frame, given those of our first keyframe."""
        ...

    def parts(self, start: SharedStart) -> list[range]:
        """Return the frames of each part, in order. The first frame is the keyframe if no part has it."""
        ...

    def train(
        self, start: SharedStart, before: Gaussians, images: Sequence[TrainingImages], iterations: int, first: int
    ) -> list[Gaussians]:
        """Return the points of each frame of a part.

        Args:
            start: Run that the baseline starts from.
            before: Points of the frame before; for the first frame those of `first`.
            images: Training images of each frame.
            iterations: Iterations of training.
            first: Number of the first frame.
        """
        ...

    def write(self, start: SharedStart, frames: Frames, reel: Path) -> None:
        """Write all frames as a reel."""
        ...


@dataclass(frozen=True)
class Frames:
    """Points of every frame in a folder.

    Attributes:
        folder: The folder.
        count: Number of frames.
    """

    folder: Path
    count: int

    def load(self, frame: int) -> Gaussians:
        """Return the points of a frame."""
        return unpack(load_arrays(self._path(frame)))

    def save(self, frame: int, points: Gaussians) -> None:
        """Save the points of a frame."""
        save_arrays(self._path(frame), pack(points))

    def _path(self, frame: int) -> Path:
        return self.folder / f"{frame:06d}.safetensors"


def run_in_parts(
    method: PartMethod,
    start: SharedStart,
    out: Path,
    seconds: float,
    progress: Progress,
    clock: Callable[[], float] = time.monotonic,
) -> dict[str, float]:
    """Train all parts and write OUT/reel. The same call continues an interrupted run.

    The points of all frames are deleted when the reel is complete.

    Args:
        method: The baseline.
        start: Run that the baseline starts from.
        out: Output folder.
        seconds: Seconds of training, those of the shared first keyframe included.
        progress: Progress display.
        clock: Clock in seconds.

    Returns:
        Seconds by stage.

    Raises:
        UsageError: The shared first keyframe alone takes longer.
    """
    if seconds <= start.shared_seconds:
        raise UsageError(
            f"{seconds / 60:.1f} minutes do not suffice: our first keyframe, which baselines start from, took "
            f"{start.shared_seconds / 60:.1f}. Allow more --minutes."
        )
    record, parts = out / RECORD, method.parts(start)
    frames = Frames(out / "frames", start.capture.frames)
    spent = [Spent(**frame) for frame in load_json(record)] if record.exists() else []
    pace = start.keyframe_seconds / start.config.keyframe.first_iterations
    budget = Budget(seconds - start.shared_seconds, len(parts), pace, spent)
    if not (out / "reel" / "manifest.json").exists():
        _train_all(method, start, frames, parts, budget, progress, record, clock)
        progress.stage("encoding", 1)
        unfinished = out / "unfinished"
        shutil.rmtree(unfinished, ignore_errors=True)
        method.write(start, frames, unfinished)
        move(unfinished, out / "reel")
    shutil.rmtree(frames.folder, ignore_errors=True)
    trained = sum(frame.seconds for frame in budget.spent)
    return {"first keyframe": round(start.shared_seconds, 3), "training": round(trained, 3)}


def _train_all(
    method: PartMethod,
    start: SharedStart,
    frames: Frames,
    parts: list[range],
    budget: Budget,
    progress: Progress,
    record: Path,
    clock: Callable[[], float],
) -> None:
    """Train the parts that are not finished."""
    done = len(budget.spent)
    if not done:
        frames.save(0, method.first(start.keyframe))
    points = frames.load(parts[done - 1][-1] if done else 0)
    progress.stage("training frames", len(parts))
    for number, part in enumerate(parts[done:], done + 1):
        images, iterations = [start.training_images(frame) for frame in part], budget.iterations()
        begun = clock()
        trained = method.train(start, points, images, iterations, part[0])
        budget.spend(clock() - begun, iterations)
        for frame, points in zip(part, trained, strict=True):
            points.check_finite(f"Frame {frame}")
            frames.save(frame, points)
        save_json(record, [asdict(cost) for cost in budget.spent])
        progress.update(number, iterations=iterations, points=len(points))
