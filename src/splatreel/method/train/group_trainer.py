"""Training of a group (paper section 4.2): dynamic points and their deformation, fitted to all frames of one group.

`FrameSchedule` orders the images: progressive frame sampling (section 4.2), then rounds over all images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from splatreel.base.errors import GaussiansError, GpuError
from splatreel.base.progress import Progress, Silent
from splatreel.config import Config
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.cameras.time_offsets import LearnedOffsets, TimeOffsets
from splatreel.method.deform.knot_adam import Restore, merge_snapshots
from splatreel.method.layering.lift import NEIGHBORS
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.cpu_program import CpuGroupProgram
from splatreel.method.train.density import GroupDensity
from splatreel.method.train.dynamic_points import DynamicPoints
from splatreel.method.train.gpu_program import group_program, unsupported
from splatreel.method.train.losses import GROUP, Terms, psnr, weight_of
from splatreel.method.train.programs import MOST_DRAWS, Draw, GroupProgram, GroupState
from splatreel.method.train.recovery import Recovery
from splatreel.method.train.render import StaticCache, draw
from splatreel.method.train.subject import spread_colors_of_group
from splatreel.method.train.terms.rigidity import Rigidity, choose_rank
from splatreel.method.train.terms.smoothness import Smoothness, choose_span
from splatreel.method.train.terms.term import Neighbors
from splatreel.method.train.trainable_points import sigmoid
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group, GroupSpan
from splatreel.scene.volumes import Volume

LEAST_PER_ROUND, MOST_PER_ROUND = 0.5, 3.0
"""Range of how often a frame is drawn per round."""


class FrameSchedule:
    """Sampler of frames and cameras.

    Frames are added in temporal order over the first `progressive` share of training. Meanwhile a third of the draws goes to
    the last three frames, which have the largest error. After that every image is drawn about once per round, in random order;
    frames with a larger loss in earlier rounds are drawn more often.
    """

    FRONTIER_SHARE = 0.35
    FRONTIER_FRAMES = 3

    def __init__(self, available: np.ndarray, iterations: int, progressive: float, seed: int) -> None:
        """Create a schedule.

        `available` [T, C]: images that exist; every frame has one. Frames are added over the share `progressive`.
        """
        self.available = available
        self.frames, self.cameras = available.shape
        self.warm = progressive * iterations
        self.rng = np.random.default_rng(seed)
        self._round: list[int] = []
        self._losses = np.full(available.shape, np.nan, np.float32)

    def frontier(self, iteration: int) -> int:
        """Return the last frame that may be drawn: floor(T n / N) of the paper."""
        if iteration >= self.warm:
            return self.frames - 1
        return min(self.frames - 1, int(self.frames * iteration / self.warm))

    def waits_for_losses(self, iteration: int) -> bool:
        """Return whether the draw of an iteration depends on the losses of all draws before it: at the start of a round."""
        return iteration >= self.warm and not self._round

    def draw(self, iteration: int) -> tuple[int, int]:
        """Return the frame and the camera of an iteration. Missing images are drawn again."""
        while True:
            frame, camera = self._draw(iteration)
            if self.available[frame, camera]:
                return frame, camera

    def _draw(self, iteration: int) -> tuple[int, int]:
        """Return a frame and a camera whose image may be missing."""
        if iteration < self.warm:
            return self._near(self.frontier(iteration)), int(self.rng.integers(self.cameras))
        if not self._round:
            copies = np.floor(
                np.repeat(self.draws_per_round(), self.cameras) + self.rng.random(self.frames * self.cameras)
            )
            images = np.repeat(np.arange(self.frames * self.cameras), copies.astype(np.int64))
            self._round = self.rng.permutation(images).tolist() or [int(self.rng.integers(self.frames * self.cameras))]
        return divmod(self._round.pop(), self.cameras)

    def record_loss(self, frame: int, camera: int, loss: float) -> None:
        """Record the loss of an image."""
        self._losses[frame, camera] = loss

    def draws_per_round(self) -> np.ndarray:
        """Return how often each frame is drawn per round, [T], mean 1: its loss relative to other frames of the same cameras."""
        losses = self._losses.astype(np.float64)
        seen = np.isfinite(losses)
        mean = np.where(seen, losses, 0).sum(0) / np.maximum(seen.sum(0), 1)
        relative = np.where(seen, losses / np.maximum(mean, 1e-12), 0).sum(1) / np.maximum(seen.sum(1), 1)
        share = np.where(seen.any(1), np.clip(relative, LEAST_PER_ROUND, MOST_PER_ROUND), 1.0)
        return share / share.mean()

    def _near(self, last: int) -> int:
        if self.rng.random() < self.FRONTIER_SHARE:
            return max(0, last - int(self.rng.integers(self.FRONTIER_FRAMES)))
        return int(self.rng.integers(last + 1))


SAMPLES = 12
"""Training images over which the PSNR of a group is averaged."""


def training_psnr(
    points: DynamicPoints,
    static: StaticCache,
    images: TrainingImages,
    gains: np.ndarray,
    time_offsets: TimeOffsets,
    available: np.ndarray,
) -> float:
    """Return the mean PSNR, dB, over a few training images spread over frames and cameras. `available` [T, C]: images that exist."""
    values = []
    for k in range(SAMPLES):
        frame = k * (images.count - 1) // (SAMPLES - 1)
        cameras = np.flatnonzero(available[frame])
        camera = int(cameras[(k * 7) % len(cameras)])
        view, moment = images.views[camera], time_offsets.moment(frame, camera, images.count)
        image, _ = draw(points.at(moment, view, images.near), view, static.view(camera))
        values.append(psnr(image * gains[camera], images.pixels[frame, camera]))
    return float(np.mean(values))


GIVE_BACK_EVERY = 50
"""Iterations between two releases of image pages. Every iteration reads one image, so all of them accumulate in memory."""
SHOW_EVERY = 50
"""Iterations between two progress updates."""


@dataclass(frozen=True)
class GroupResult:
    """Result of a group's training.

    Attributes:
        dx: [T, N, 3] position offsets at every frame, world units.
        dq: [T, N, 4] rotation offsets at every frame.
        alive: [S] bool, static points that are still static.
        shade: [T, N, 4] as in `Group`; None if appearance is fixed.
        time_offsets: Learned time offsets of the cameras; None if they are not learned.
    """

    dynamic: Gaussians
    dx: np.ndarray
    dq: np.ndarray
    alive: np.ndarray
    shade: np.ndarray | None
    time_offsets: LearnedOffsets | None

    def as_group(self, span: GroupSpan, light: np.ndarray | None) -> Group:
        """Return the group of a span of frames. `light`: see `Group`."""
        arrays = self.dynamic, self.dx, self.dq, self.alive, self.shade, light
        return Group(span.index, span.first, *arrays)


def group_result(points: DynamicPoints, frames: int, alive: np.ndarray, offsets: LearnedOffsets | None) -> GroupResult:
    """Collect a group's points and their changes at every frame as arrays. `alive` [S]: static points that are still static."""
    changes = [points.changes(frame) for frame in range(frames)]
    dx, dq = np.stack([c.dx for c in changes]), np.stack([c.dq for c in changes])
    logits = points.canonical.params["logit_opacities"]
    shades = [_shade(c.shade, logits) for c in changes if c.shade is not None]
    shade = np.stack(shades) if shades else None
    return GroupResult(points.canonical.gaussians(), dx, dq, alive.copy(), shade, offsets)


def _shade(shade: np.ndarray, logits: np.ndarray) -> np.ndarray:
    """Return [N, 4] as in `Group`: the change of the opacity instead of the change of its logit."""
    return np.concatenate([shade[:, :3], (sigmoid(logits + shade[:, 3]) - sigmoid(logits))[:, None]], 1)


class GroupTrainer:
    """Trainer of one group. Static points stay frozen unless density control makes them dynamic (paper section 4.1)."""

    def __init__(
        self,
        images: TrainingImages,
        start: GroupStart,
        static: StaticPoints,
        config: Config,
        *,
        gains: CameraGains,
        time_offsets: TimeOffsets | None = None,
        may_move: np.ndarray | None = None,
        seed: int = 0,
        missing: np.ndarray | None = None,
        region: Volume | None = None,
        gpu: SharedGpu | None = None,
        losses: Terms | None = None,
    ) -> None:
        """Prepare the training of a group.

        `may_move` [S] are the static points that density control may make dynamic; None allows all living ones. Images
        of `missing` [T, C] are not trained on. Points are cloned within `region` only. `losses` is a list of terms;
        None is `losses.GROUP`.
        """
        group = config.group
        self.config = config
        self.losses = GROUP if losses is None else losses
        self.gains = gains
        self.iterations = group.iterations_per_frame * images.count
        sizes = images.sizes(self.iterations, group.coarse_share, config.training_megapixels)
        self.images = sizes[0][1]
        self.larger_images = [(end, larger) for (end, _), (_, larger) in pairwise(sizes)]
        self.time_offsets = time_offsets or TimeOffsets(len(images.views), enabled=False)
        self.points = DynamicPoints.of(start, self.images, group, seed)
        self.static = StaticCache(static.points, self.images.all_views, images.near)
        self.static.set_alive(static.alive)
        available = np.ones((images.count, len(images.views)), bool) if missing is None else ~missing
        self.schedule = FrameSchedule(available, self.iterations, group.progressive_share, seed)
        self.rng = np.random.default_rng(seed)
        movable = static.alive if may_move is None else may_move
        self.density = GroupDensity(self.points, self.static, movable, config, self.iterations, self.rng, region)
        self.gpu = gpu
        self.program: GroupProgram | None = None
        self.find_neighbors()
        self.recovery = Recovery()

    def train(self, progress: Progress) -> GroupResult:
        """Run all iterations."""
        if len(self.points) == 0:
            progress.note("nothing moves in this group: it has no dynamic points")
            return self.result()
        done = 0
        self.recovery.save_state(done, self)
        self.start_program(progress)
        while done < self.iterations:
            try:
                done = self._iterate(done, progress)
            except GaussiansError as error:
                done = self.recovery.restore(done + 1, error, progress)
                self.start_program(progress)
            except GpuError as error:
                done = self._continue_without_gpu(error, progress)
        self.recovery.release_state()
        self.program = None
        if self.images.opposite is not None:
            spread_colors_of_group(self.points, self.images, self.static)
        quality = self.psnr()
        progress.update(self.iterations, moving=len(self.points), psnr=quality)
        progress.note(f"PSNR of the group's training images: {quality:.1f} dB")
        return self.result()

    def step(self, iteration: int) -> float:
        """Run one iteration on one image, without density control, and return its photometric loss.

        Raises:
            GaussiansError: A value is NaN or infinite.
            GpuError: The GPU was lost, or has too little memory.
        """
        if self.program is None:
            self.start_program(Silent())
        self._choose_images(iteration)
        return self._run([self.plan(iteration)])

    def _iterate(self, iteration: int, progress: Progress) -> int:
        """Run iterations until something is due, and the actions that are due after them. Return the number of finished iterations."""
        self._choose_images(iteration)
        draws = [self.plan(iteration)]
        while len(draws) < self._most_draws() and not self._stops(iteration + len(draws)):
            draws.append(self.plan(iteration + len(draws)))
        loss, done = self._run(draws), iteration + len(draws)
        if self._needs_host(done):
            self._download(self._needs_moments(done))
        if done % GIVE_BACK_EVERY == 0:
            self.images.release_pages()
        self.recovery.check_iteration(done, loss, self)
        if self.density.update(done, self.images):
            self.find_neighbors()
            self._upload()
        if self._shows(done - 1) or done == self.iterations:
            self.points.check()
            progress.update(done, loss=loss, moving=len(self.points))
        return done

    def start_program(self, progress: Progress) -> None:
        """Choose what runs the iterations: the GPU if there is one that can, else the CPU."""
        learns_time = self.time_offsets.enabled and self.images.count > 1
        parts = self.points, self.density, self.images, self.config.group, self.losses, self.gains, learns_time
        state = GroupState(*parts)
        try:
            opened = None if self.gpu is None else self.gpu.open()
            why = None if opened is None else unsupported(opened, state)
            if why is not None:
                progress.note(f"this group is trained on the CPU: {why}")
            if opened is None or why is not None:
                self.program = CpuGroupProgram(state)
            else:
                self.program = group_program(opened, state)
            self._upload()
        except GpuError as error:
            self._continue_without_gpu(error, progress)

    def _continue_without_gpu(self, error: GpuError, progress: Progress) -> int:
        """Return to the last good state, to continue on the CPU. Return the number of iterations that are done in it."""
        assert self.gpu is not None
        self.program = None
        done = self.recovery.leave_gpu(self.gpu, error, progress)
        self.start_program(progress)
        return done

    def _upload(self) -> None:
        if self.program is not None:
            self.program.neighbors = self.neighbors
            self.program.images = self.images
            self.program.upload()

    def _download(self, moments: bool = True) -> None:
        if self.program is not None:
            self.program.give_meters()
            self.program.download(moments)

    def _run(self, draws: Sequence[Draw]) -> float:
        """Run iterations of the program, and return the loss of the last one."""
        assert self.program is not None
        outcomes = self.program.run(draws)
        for step, outcome in zip(draws, outcomes, strict=True):
            if self.program.learns_time:
                self.time_offsets.note(step.camera, outcome.slope, step.share)
            if not step.whole and not step.metered_static:  # otherwise the loss covers another set of pixels
                self.schedule.record_loss(step.frame, step.camera, outcome.loss)
        return outcomes[-1].loss

    def _most_draws(self) -> int:
        """Return the largest number of draws none of which depends on the results of the others."""
        learns_time = self.program is not None and self.program.learns_time
        return min(MOST_DRAWS, self.time_offsets.independent) if learns_time else MOST_DRAWS

    def _stops(self, done: int) -> bool:
        """Return whether a batch of the program ends after `done` iterations."""
        shown = self._shows(done - 1) or done % GIVE_BACK_EVERY == 0
        return shown or self._needs_host(done) or self.schedule.waits_for_losses(done)

    def _needs_host(self, done: int) -> bool:
        """Return whether the host needs the state after `done` iterations."""
        resizes = bool(self.larger_images) and done >= self.larger_images[0][0]
        return resizes or self.density.is_due(done) or self._needs_moments(done)

    def _needs_moments(self, done: int) -> bool:
        """Return whether the host needs Adam's moments of the points after `done` iterations."""
        return done >= self.recovery.next_save or done == self.iterations

    def plan(self, iteration: int) -> Draw:
        """Decide what an iteration draws and compares, with all random choices."""
        frame, camera = self.schedule.draw(iteration)
        share, whole = iteration / self.iterations, self._shows(iteration)  # the reported loss covers the whole image
        last, count = self.schedule.frontier(iteration), self.images.count
        step = Draw(
            iteration=iteration,
            share=share,
            pace=self.recovery.pace,
            frame=frame,
            last=last,
            camera=camera,
            moment=self.time_offsets.moment(frame, camera, count),
            whole=whole,
            metered=self.density.measures(iteration),
            metered_static=not whole and self.density.measured_static(iteration) is not None,
            rank=None,
            span=None,
        )
        weight = partial(weight_of, losses=self.losses, step=step, config=self.config.group)
        neighbors = self.neighbors if weight(Rigidity) else None
        rank = None if neighbors is None else choose_rank(neighbors, self.rng)
        span = choose_span(frame, count, last, self.rng) if weight(Smoothness) else None
        return replace(step, rank=rank, span=span)

    def snapshot(self) -> Restore:
        """Copy everything that training changes."""
        parts = merge_snapshots([self.points.snapshot(), self.time_offsets.snapshot()])
        alive, budget = self.static.alive, self.density.budget

        def restore() -> None:
            parts()
            self.static.revive(alive)
            self.density.budget = budget
            self.density.restart()
            self.find_neighbors()

        return restore

    def check(self) -> None:
        """Raise a `GaussiansError` if a value is NaN or infinite."""
        self.points.check()

    def find_neighbors(self) -> None:
        """Find the neighbors of every point again, after points were added, removed or moved."""
        self.neighbors = Neighbors.of(self.points.means, NEIGHBORS)

    def result(self) -> GroupResult:
        """Return the trained points and their changes."""
        self._download()
        offsets = self.time_offsets.learned() if self.time_offsets.enabled else None
        found = group_result(self.points, self.images.count, self.static.alive, offsets)
        return replace(found, dynamic=replace(found.dynamic, near=self.images.near))

    def psnr(self) -> float:
        """Return the mean PSNR, dB, over a few training images."""
        self._download()
        return training_psnr(
            self.points, self.static, self.images, self.gains.values, self.time_offsets, self.schedule.available
        )

    def _choose_images(self, iteration: int) -> None:
        """Switch to images of another size, if due before an iteration."""
        if not self.larger_images or iteration < self.larger_images[0][0]:
            return
        while self.larger_images and iteration >= self.larger_images[0][0]:
            self.images = self.larger_images.pop(0)[1]
        self._download()
        self.static.set_views(self.images.all_views)
        self.density.restart()
        self.find_neighbors()
        self._upload()

    def _shows(self, iteration: int) -> bool:
        return (iteration + 1) % SHOW_EVERY == 0
