"""Training of a keyframe with 3DGS, from sparse points or from the previous group (paper section 5.1).

The result is the running mean of the last iterations (`Average`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from splatreel.base.errors import GaussiansError, GpuError
from splatreel.base.progress import Progress
from splatreel.config import KeyframeConfig
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.kernels import splat
from splatreel.kernels.splat import Splats
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.deform.knot_adam import Restore, merge_snapshots
from splatreel.method.train.cpu_program import CpuKeyframeProgram
from splatreel.method.train.density import ADDED_SHARE, KeyframeDensity, OpacityResets, adds_after, points_at_errors
from splatreel.method.train.gpu_program import keyframe_program, unsupported
from splatreel.method.train.losses import GROWTH, KEYFRAME, Terms, psnr
from splatreel.method.train.programs import MOST_DRAWS, KeyframeDraw, KeyframeProgram, KeyframeState
from splatreel.method.train.recovery import Recovery
from splatreel.method.train.render import StaticCache, View, deformed, draw
from splatreel.method.train.subject import seen_shares, spread_colors
from splatreel.method.train.trainable_points import NAMES, TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.volumes import Volume

AVERAGE_EVERY = 4
"""Iterations between two samples of the mean. Neighboring iterations hardly differ."""


class Average:
    """Running mean of arrays over the last `share` of the iterations. Programs compute it from the weights of its samples.

    Source:
        Polyak averaging; for networks, Izmailov et al. 2018.
    """

    def __init__(self, share: float, iterations: int) -> None:
        self.after = iterations - round(share * iterations)
        self._means: list[np.ndarray] = []
        self._count = 0

    def has_begun(self, done: int) -> bool:
        """Return whether averaging has begun. done: number of finished iterations."""
        return done > self.after

    def restart(self) -> None:
        """Forget all samples, after rows were added or removed."""
        self._means = []
        self._count = 0

    def next_weight(self, done: int) -> float:
        """Count the values after an iteration. Return their weight in the mean; 0 if they are not a sample."""
        if not self.has_begun(done) or done % AVERAGE_EVERY:
            return 0.0
        self._count += 1
        return 1 / self._count

    def set_means(self, means: list[np.ndarray]) -> None:
        """Take over means that a program computed; does nothing without samples."""
        if self._count:
            self._means = means

    def write_to(self, arrays: Iterable[np.ndarray]) -> None:
        """Write the mean to the arrays, if it has their shapes."""
        now = list(arrays)
        if [mean.shape for mean in self._means] == [array.shape for array in now]:
            for array, mean in zip(now, self._means, strict=True):
                array[:] = mean


SHOW_EVERY = 24
"""Iterations between two progress updates. It is even, so that iterations run in pairs."""
GAINS_EVERY = 4
"""Iterations between two comparisons of whole images in front of static points, which the color gains are learned from. Other
iterations compare only tiles with moving points."""


@dataclass(frozen=True)
class KeyframeResult:
    """Result of a keyframe's training.

    Attributes:
        gains: [C, 3] float32, learned color gains of the cameras.
        alive: [S] bool, static points that the first keyframe of a chapter keeps; None for all other keyframes, which keep all.
    """

    points: Gaussians
    gains: np.ndarray
    alive: np.ndarray | None = None


def starting_points(positions: np.ndarray, colors: np.ndarray, config: KeyframeConfig, unit: float) -> TrainablePoints:
    """Create Gaussians at sparse points [P, 3] with colors 0..1, as large as the distance to their neighbors (3DGS, section 5.1)."""
    points = np.asarray(positions, np.float32)
    count, neighbors = len(points), min(3, len(points) - 1)
    if neighbors > 0:
        distances = splat.nearest_neighbors(points, neighbors)[1]
        size = np.clip(np.sqrt(np.square(distances).mean(1)), np.float32(2e-3 * unit), np.float32(0.07 * unit))
    else:
        size = np.full(count, 0.02 * unit, np.float32)
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1
    params = {
        "means": points,
        "quats": quats,
        "log_scales": np.repeat(np.log(size)[:, None], 3, 1),
        "logit_opacities": np.full(count, math.log(0.1 / 0.9), np.float32),
        "sh_base": ((np.asarray(colors, np.float32) - np.float32(0.5)) / np.float32(C0))[:, None],
        "sh_rest": np.zeros((count, (config.sh_degree + 1) ** 2 - 1, 3), np.float32),
    }
    return TrainablePoints(params, default_rates(unit, config.rate_scale))


class KeyframeTrainer:
    """Trainer of the points of one frame, in front of frozen static points if there are any."""

    def __init__(
        self,
        points: TrainablePoints,
        gains: CameraGains,
        config: KeyframeConfig,
        *,
        static: Gaussians | None = None,
        max_points: int,
        losses: Terms | None = None,
        seed: int = 0,
        region: Volume | None = None,
        gpu: SharedGpu | None = None,
    ) -> None:
        """Prepare the training of a keyframe, in front of frozen `static` points.

        `losses` is a list of terms; None is `losses.KEYFRAME`. Points are densified within `region` only. The color
        gains are trained too. Without a GPU, the iterations run on the CPU.
        """
        self.points = points
        self.gains = gains
        self.config = config
        self.static = static
        self.losses = KEYFRAME if losses is None else losses
        self.density = KeyframeDensity(points, config, max_points, seed, region)
        self.rng = np.random.default_rng(seed)
        self.done = 0
        self.gpu = gpu
        self.program: KeyframeProgram | None = None
        self.recovery = Recovery()
        self.watch: Callable[[Callable[[], Gaussians]], None] | None = None
        """Called during training with a function that returns the points as they are now."""

    def train(self, images: TrainingImages, iterations: int, total: int, progress: Progress) -> None:
        """Run `iterations` of `total` on images of one resolution. Another call continues with other images."""
        static = self._static_cache(images)
        average = Average(self.config.average_share, total)
        self.density.restart(images)
        end, self._cameras = self.done + iterations, list[int]()
        self.recovery.save_state(self.done, self)
        self._start_program(images, static, progress)
        while self.done < end:
            try:
                loss = self._run_batch(images, total, end, average)
                self._finish_iteration(images, static, total, average)
                if self.done % SHOW_EVERY == 0 or self.done == end:
                    self.check()
                    progress.update(self.done, loss=loss, points=len(self.points))
                    if self.watch is not None:
                        self.watch(self._gaussians_now)
            except (GaussiansError, GpuError) as error:
                self.done = self._recover(error, progress)
                self._anneal(self.done / total)
                self.density.restart(images)
                average = Average(self.config.average_share, total)
                self._start_program(images, static, progress)
        self.recovery.release_state()
        average.write_to(self.points.params.values())
        self.program = None
        self.density.prune(images.unit, self.done / total)
        if images.opposite is not None:
            spread_colors(self.points, seen_shares(self.points, images, static))

    def _finish_iteration(
        self, images: TrainingImages, static: StaticCache | None, total: int, average: Average
    ) -> None:
        """Add, prune and average points after an iteration, if due."""
        share, averaged = self.done / total, average.has_begun(self.done)
        changes = self.density.is_due(self.done, share, averaged) or self._changes_detail(total)
        self.density.update(self.done, share, images, averaged, self.config.detail and static is None)
        if images.opposite is not None and self.density.is_due(self.done, share, averaged):
            spread_colors(self.points, seen_shares(self.points, images, static))
        if self._changes_detail(total):
            self._change_detail(images, total)
        if changes and self.program is not None:
            average.restart()
            self.program.upload()

    def _next_camera(self, images: TrainingImages) -> int:
        self._cameras = self._cameras or self.rng.permutation(len(images.views)).tolist()
        return self._cameras.pop()

    def _start_program(self, images: TrainingImages, static: StaticCache | None, progress: Progress) -> None:
        """Choose what runs the iterations: the GPU if there is one that can, else the CPU."""
        state = KeyframeState(self.points, static, self.density, images, self.config, self.losses, self.gains)
        try:
            opened = None if self.gpu is None else self.gpu.open()
            why = None if opened is None else unsupported(opened, state)
            if why is not None:
                progress.note(f"this keyframe is trained on the CPU: {why}")
            if opened is None or why is not None:
                self.program = CpuKeyframeProgram(state)
            else:
                self.program = keyframe_program(opened, state)
            self.program.upload()
        except GpuError as error:
            self._recover(error, progress)
            self._start_program(images, static, progress)

    def _recover(self, error: GaussiansError | GpuError, progress: Progress) -> int:
        """Return to the last good state: at a lower pace, or without the GPU. Return the number of iterations done in it."""
        if isinstance(error, GaussiansError):
            return self.recovery.restore(self.done, error, progress)
        assert self.gpu is not None
        self.program = None
        return self.recovery.leave_gpu(self.gpu, error, progress)

    def _gaussians_now(self) -> Gaussians:
        """Return the points as they are now, from the device that trains."""
        if self.program is not None:
            self.program.download(moments=False)
        return self.points.gaussians()

    def _run_batch(self, images: TrainingImages, total: int, end: int, average: Average) -> float:
        """Run iterations of the program until something is due, and return the loss of the last one."""
        assert self.program is not None
        draws = [self._plan(images, self.done, total, average)]
        while not self._stops(self.done + len(draws), total, end, average) and len(draws) < MOST_DRAWS:
            draws.append(self._plan(images, self.done + len(draws), total, average))
        loss = self.program.run(draws)[-1].loss
        self.done += len(draws)
        self._anneal(self.done / total)
        if self._needs_host(self.done, total, end, average):
            self.program.give_meters()
            self.program.download(self._needs_moments(self.done, total, end))
            if self.done == end:
                average.set_means(self.program.averages())
        self.recovery.check_iteration(self.done, loss, self)
        return loss

    def _stops(self, done: int, total: int, end: int, average: Average) -> bool:
        return done % SHOW_EVERY == 0 or self._needs_host(done, total, end, average)

    def _needs_host(self, done: int, total: int, end: int, average: Average) -> bool:
        """Return whether the host needs the state after `done` iterations."""
        due = self.density.is_due(done, done / total, average.has_begun(done))
        return due or self._changes_detail(total, done) or self._needs_moments(done, total, end)

    def _needs_moments(self, done: int, total: int, end: int) -> bool:
        """Return whether the host needs Adam's moments after `done` iterations: to save or reset them, or for the next program."""
        resets = OpacityResets(total, len(self.gains.values)).is_due(done)
        return resets or done >= self.recovery.next_save or done == end

    def _plan(self, images: TrainingImages, iteration: int, total: int, average: Average) -> KeyframeDraw:
        """Decide what an iteration of the program draws and compares."""
        done, share = iteration + 1, iteration / total
        factors = self._rate_factors(share)
        return KeyframeDraw(
            iteration=iteration,
            share=share,
            camera=self._next_camera(images),
            whole=not self.static or self._compares_all(images, iteration),
            metered=done / total <= GROWTH,
            average=average.next_weight(done),
            rates=tuple(self.points.base_rates[name] * factors[name] for name in NAMES),
        )

    def snapshot(self) -> Restore:
        """Copy everything that training changes."""
        return merge_snapshots([self.points.snapshot(), self.gains.snapshot()])

    def check(self) -> None:
        """Raise a `GaussiansError` if a value is NaN or infinite."""
        self.points.check()
        splat.check_finite(gains=self.gains.values)

    def psnr(self, images: TrainingImages) -> float:
        """Return the mean PSNR, dB, over the training images, without static points."""
        drawn = [self._draw(images, camera)[1] for camera in range(len(images.views))]
        return float(np.mean([psnr(image, target) for image, target in zip(drawn, images.pixels[0], strict=True)]))

    def _draw(self, images: TrainingImages, camera: int) -> tuple[Splats, np.ndarray]:
        """Return the projected points of a camera, without static points, and the image [H, W, 3] that the camera would take."""
        view, gain = images.views[camera], self.gains.values[camera]
        splats, factor = with_gain(deformed(self.points.params, None, None, view, images.near), view, gain)
        return splats, draw(splats, view)[0] * factor

    def _changes_detail(self, total: int, done: int | None = None) -> bool:
        """Return whether `_change_detail` has work after `done` iterations of `total`; None asks about now."""
        done = self.done if done is None else done
        due = adds_after(done, total) or OpacityResets(total, len(self.gains.values)).is_due(done)
        return due and self.config.detail and self.static is None

    def _change_detail(self, images: TrainingImages, total: int) -> None:
        """Reset opacities, prune the points that did not recover, or add points where images differ most from the drawings."""
        if OpacityResets(total, len(self.gains.values)).update(self.done, self.points):
            self.density.restart(images)
        if adds_after(self.done, total):
            count = max(min(self.density.room, round(ADDED_SHARE * len(self.points))), 0)
            bands, gains = self.points.params["sh_rest"].shape[1], self.gains.values
            draw_camera = partial(self._draw, images)
            self.density.add(points_at_errors(draw_camera, images, gains, bands, count, self.rng), images)

    def _static_cache(self, images: TrainingImages) -> StaticCache | None:
        if self.static is None or len(self.static) == 0:
            return None
        return StaticCache(self.static, images.all_views, images.near)

    def _compares_all(self, images: TrainingImages, iteration: int) -> bool:
        shows = (iteration + 1) % SHOW_EVERY == 0
        return shows or iteration % GAINS_EVERY == 0 or images.unknown is not None

    def _rate_factors(self, share: float) -> dict[str, float]:
        """Return the factors of the learning rates by attribute, after a share of training."""
        late, pace = 0.3 if share > 0.8 else 1.0, self.recovery.pace
        factors = dict.fromkeys(NAMES, late) | {
            "means": 0.02**share,
            "quats": 1.0,
            "log_scales": 0.2 if share > 0.8 else 1.0,
        }
        return {name: pace * factor for name, factor in factors.items()}

    def _anneal(self, share: float) -> None:
        self.points.scale_rates(self._rate_factors(share))


def with_gain(splats: Splats, view: View, gain: np.ndarray) -> tuple[Splats, np.ndarray]:
    """Return the splats to draw, and the factor [3] on the drawing, for a camera's color gain [3].

    A background without a gain was divided by the gain that was known when the view was made. The splats then carry the rest of
    the gain, so that the gain is learned from them alone.
    """
    if view.gain is None:
        return splats, gain
    factor, behind = gain / view.gain, view.background
    colors = splats.colors * factor if behind is None else (splats.colors + behind) * factor - behind
    return splats._replace(colors=colors), view.gain
