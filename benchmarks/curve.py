"""Measure the PSNR of a held-out camera against the seconds of a reconstruction."""

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.oracle import held_out_views
from splatreel.base.process import peak_memory_bytes
from splatreel.base.progress import Estimate, Progress, Span
from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.evaluation.evaluate import evaluate
from splatreel.kernels.splat import Splats
from splatreel.method.train.group_trainer import GroupResult, GroupTrainer, psnr
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.render import View, deformed, draw
from splatreel.method.train.trainable_points import to_params
from splatreel.method.train.training_images import TrainingImages
from splatreel.run.jobs import ChapteredRun
from splatreel.run.output.group_writer import no_presentation
from splatreel.run.pipeline import plan_run, reconstruct_run

POINTS = 40
"""Of a curve, at most."""


class OutOfTime(Exception):
    """Raised when the time limit of a training is over."""


def reconstruct_until(
    found: dict[str, Any], capture: Capture, out: Path, config: Config, device: str, limit: float, shown: Progress
) -> None:
    """Reconstruct a capture into OUT from scratch, for at most `limit` seconds. Put the values to record into `found`.

    Steps without progress reports, such as writing a group, are completed. `found` is filled even if an error is raised.

    Raises:
        UsageError: No camera is held out. Errors of the capture and of `reconstruct` are passed on.
    """
    shutil.rmtree(out, ignore_errors=True)  # seconds of a run that is continued are not comparable
    run = plan_run(capture, out, config, device=device)
    curve = Curve(run, limit, shown)
    found |= {"width": capture.width, "height": capture.height, "frames": capture.frames, "seed": config.seed}
    found |= {"held_out": curve.camera.name, "psnr_at": curve.points, "stages": curve.stages, "finished": False}
    try:
        with watched(curve):
            reconstruct_run(run, curve, no_presentation)
        found["finished"] = True
    except OutOfTime:
        shown.note(f"stopped after {curve.seconds():.0f} s: its time is over")
    finally:
        curve.look = None
        found |= curve.summary(found["finished"])
        found["memory_mb"] = round((peak_memory_bytes() or 0) / 1e6, 1)
    if found["finished"]:
        frames = sorted({0, capture.frames // 2, capture.frames - 1})
        report = evaluate(out / "reel", capture, cameras=[curve.camera.name], frames=frames)
        found |= {"psnr": report.psnr, "reel_bytes": report.reel_bytes}


@dataclass
class Curve:
    """Progress that forwards to another one, measures from time to time, and raises `OutOfTime` after `limit` seconds.

    points: (seconds, dB) of the first held-out camera: of a keyframe's first frame, or the mean over three frames of a group. Seconds
    do not include those of measuring. stages: what ran, for how long, and how many of its steps. look: measures what is trained at the
    moment, if anything is. group: the index of the one that is at work.
    """

    run: ChapteredRun
    limit: float
    shown: Progress
    points: list[tuple[float, float]] = field(default_factory=list)
    stages: list[dict[str, Any]] = field(default_factory=list)
    look: Callable[[], float] | None = None
    group: int = 0

    def __post_init__(self) -> None:
        self.camera = held_out_views(self.run.capture)[0]
        self._truths: dict[int, np.ndarray] = {}
        self._start = time.monotonic()
        self._measuring = 0.0
        self.estimate = Estimate(self.seconds)

    def seconds(self) -> float:
        """Return the seconds since the start, without those of measuring."""
        return time.monotonic() - self._start - self._measuring

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        self.look = None
        self._note_seconds()
        self.estimate.stage(total, span)
        self.stages.append({"stage": name, "begin": round(self.seconds(), 2), "seconds": 0.0, "done": 0, "of": total})
        self.shown.stage(name, total, span)
        self._check()

    def update(self, done: int, **numbers: float) -> None:
        self.estimate.done = done
        if self.stages:
            self.stages[-1] |= {"done": done, **numbers}
        due = not self.points or self.seconds() - self.points[-1][0] >= self.limit / POINTS
        last = done >= self.estimate.total or self.seconds() > self.limit
        if self.look is not None and (due or last):
            before, at = time.monotonic(), self.seconds()
            self.points.append((round(at, 2), round(self.look(), 3)))
            self._measuring += time.monotonic() - before
            numbers["psnr"] = self.points[-1][1]
        self.shown.update(done, **numbers)
        self._check()

    def note(self, text: str) -> None:
        self.shown.note(text)

    def summary(self, finished: bool) -> dict[str, Any]:
        """Return the seconds in total and per frame. For an unfinished run they are extrapolated, or None."""
        self._note_seconds()
        taken, frames = self.seconds(), self.run.capture.frames
        left = 0.0 if finished else self.estimate.seconds_left()
        a_frame = None if left is None else round((taken + left) / frames, 4)
        return {"seconds": round(taken, 2), "seconds_a_frame" if finished else "seconds_a_frame_expected": a_frame}

    def look_at_keyframe(self, trainer: KeyframeTrainer, images: TrainingImages) -> float:
        """Return the PSNR of the held-out camera at the group's first frame, dB."""
        view, near = self._view(images), images.near
        seen = deformed(trainer.points.params, None, None, view, near)
        if trainer.static is not None and len(trainer.static):
            still = to_params(trainer.static)
            seen = Splats.join(seen, deformed(still, None, None, view, max(near, view.clear)))
        return psnr(draw(seen, view)[0], self._truth(self.run.groups[self.group].first))

    def look_at_group(self, trainer: GroupTrainer) -> float:
        """Return the mean PSNR of the held-out camera over the first, middle and last own frame of the group, dB."""
        view, near, span = self._view(trainer.images), trainer.images.near, self.run.groups[self.group]
        alive = {name: value[trainer.static.alive] for name, value in trainer.static.params.items()}
        still = deformed(alive, None, None, view, max(near, view.clear))
        values = []
        for frame in sorted({0, span.own // 2, span.own - 1}):
            seen = Splats.join(trainer.points.at(frame, view, near), still)
            values.append(psnr(draw(seen, view)[0], self._truth(span.first + frame)))
        return float(np.mean(values))

    def _view(self, images: TrainingImages) -> View:
        """Return the held-out camera as a view at full size."""
        return View.of(self.camera, images.views[0].antialias, self.run.store.layout())

    def _truth(self, frame: int) -> np.ndarray:
        if frame not in self._truths:
            self._truths[frame] = self.run.capture.read(frame, 1, [self.camera.name])[0, 0]
        return self._truths[frame]

    def _note_seconds(self) -> None:
        if self.stages:
            self.stages[-1]["seconds"] = round(self.seconds() - self.stages[-1]["begin"], 2)

    def _check(self) -> None:
        if self.seconds() > self.limit:
            raise OutOfTime


@contextmanager
def watched(curve: Curve) -> Iterator[None]:
    """Pass the trained points to the curve, because progress only reports steps."""
    keyframe, group = KeyframeTrainer.train, GroupTrainer.train

    def train_keyframe(
        self: KeyframeTrainer, images: TrainingImages, iterations: int, total: int, progress: Progress
    ) -> None:
        curve.look = lambda: curve.look_at_keyframe(self, images)
        keyframe(self, images, iterations, total, progress)
        curve.look = None

    def train_group(self: GroupTrainer, progress: Progress) -> GroupResult:
        curve.look = lambda: curve.look_at_group(self)
        result = group(self, progress)
        curve.look, curve.group = None, curve.group + 1
        return result

    KeyframeTrainer.train, GroupTrainer.train = train_keyframe, train_group
    try:
        yield
    finally:
        KeyframeTrainer.train, GroupTrainer.train = keyframe, group
