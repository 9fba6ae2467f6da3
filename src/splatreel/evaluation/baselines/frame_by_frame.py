"""Baselines that train one frame after the other: the loop, its time, its checkpoints, and the reel at its end."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

from splatreel.errors import UsageError
from splatreel.evaluation.baselines.budget import Budget, Spent
from splatreel.evaluation.baselines.shared_start import SharedStart
from splatreel.progress import Progress
from splatreel.recon.run import checkpoint
from splatreel.recon.train.pictures import Pictures
from splatreel.scene.gaussians import Gaussians

RECORD = "frames.json"
"""File with the cost of each finished frame."""


class FrameMethod(Protocol):
    """Method that trains a frame from the frame before and writes all frames as a reel."""

    def first(self, keyframe: Gaussians) -> Gaussians:
        """Return the points of the first frame, given those of our first keyframe."""
        ...

    def train(
        self, start: SharedStart, before: Gaussians, pictures: Pictures, iterations: int, frame: int
    ) -> Gaussians:
        """Return the points of a frame.

        Args:
            start: Run that the baseline starts from.
            before: Points of the frame before.
            pictures: Training images of the frame.
            iterations: Iterations of training.
            frame: Number of the frame.
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
        return checkpoint.unpack(checkpoint.load_arrays(self._path(frame)))

    def save(self, frame: int, points: Gaussians) -> None:
        """Save the points of a frame."""
        checkpoint.save_arrays(self._path(frame), checkpoint.pack(points))

    def _path(self, frame: int) -> Path:
        return self.folder / f"{frame:06d}.safetensors"


def run_frame_by_frame(
    method: FrameMethod,
    start: SharedStart,
    out: Path,
    seconds: float,
    progress: Progress,
    clock: Callable[[], float] = time.monotonic,
) -> dict[str, float]:
    """Train all frames and write OUT/reel. The same call continues an interrupted run.

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
    record, count = out / RECORD, start.capture.frames
    frames = Frames(out / "frames", count)
    spent = [Spent(**frame) for frame in checkpoint.load_json(record)] if record.exists() else []
    pace = start.keyframe_seconds / start.config.keyframe.first_iterations
    budget = Budget(seconds - start.shared_seconds, count - 1, pace, spent)
    if not (out / "reel" / "manifest.json").exists():
        _train_all(method, start, frames, budget, progress, record, clock)
        progress.stage("encoding", 1)
        unfinished = out / "unfinished"
        shutil.rmtree(unfinished, ignore_errors=True)
        method.write(start, frames, unfinished)
        unfinished.rename(out / "reel")
    shutil.rmtree(frames.folder, ignore_errors=True)
    trained = sum(frame.seconds for frame in budget.spent)
    return {"first keyframe": round(start.shared_seconds, 3), "training": round(trained, 3)}


def _train_all(
    method: FrameMethod,
    start: SharedStart,
    frames: Frames,
    budget: Budget,
    progress: Progress,
    record: Path,
    clock: Callable[[], float],
) -> None:
    """Train the frames that are not finished."""
    done = len(budget.spent)
    if not done:
        frames.save(0, method.first(start.keyframe))
    points = frames.load(done)
    progress.stage("training frame by frame", frames.count - 1)
    for frame in range(done + 1, frames.count):
        pictures, iterations = start.pictures(frame), budget.iterations()
        begun = clock()
        points = method.train(start, points, pictures, iterations, frame)
        budget.spend(clock() - begun, iterations)
        points.check_finite(f"Frame {frame}")
        frames.save(frame, points)
        checkpoint.save_json(record, [asdict(cost) for cost in budget.spent])
        progress.update(frame, iterations=iterations, points=len(points))
