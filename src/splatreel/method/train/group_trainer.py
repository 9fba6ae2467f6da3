"""Training of a group (paper section 4.2): dynamic points and their deformation, fitted to all frames of one group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from splatreel.base.errors import GaussiansError, GpuError
from splatreel.base.progress import Progress
from splatreel.config import Config
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.cameras.time_offsets import LearnedOffsets, TimeOffsets, slope
from splatreel.method.deform.knot_adam import Restore, merge_snapshots
from splatreel.method.layering.lift import NEIGHBORS
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.cpu_group import CpuGroupProgram
from splatreel.method.train.density import GroupDensity
from splatreel.method.train.dynamic_points import Changes, DynamicPoints
from splatreel.method.train.frame_sampling import FrameSchedule
from splatreel.method.train.gpu_group import GpuGroupProgram
from splatreel.method.train.losses import (
    GROUP,
    GroupStep,
    Loss,
    backward,
    choose_rank,
    choose_span,
    reported_loss,
    rigidity,
    smoothness,
    weight_of,
)
from splatreel.method.train.programs import GROUP_COSTS, MOST_DRAWS, Draw, GroupState, unsupported_losses
from splatreel.method.train.recovery import Recovery
from splatreel.method.train.regularizers import Neighbors
from splatreel.method.train.render import StaticCache, draw, moving_tiles
from splatreel.method.train.training_images import TrainingImages
from splatreel.method.train.training_psnr import training_psnr
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.spans import GroupSpan
from splatreel.scene.static_points import StaticPoints
from splatreel.scene.volumes import Volume

GIVE_BACK_EVERY = 50
"""Iterations between two releases of image pages. Every iteration reads one image, so all of them accumulate in memory."""
SHOW_EVERY = 50
"""Iterations between two progress updates."""


@dataclass(frozen=True)
class GroupResult:
    """Result of a group's training.

    Attributes:
        dynamic: Canonical points.
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


@torch.no_grad()
def group_result(points: DynamicPoints, frames: int, alive: Tensor, offsets: LearnedOffsets | None) -> GroupResult:
    """Collect a group's points and their changes at every frame as arrays.

    Args:
        points: Trained points.
        frames: Number of frames, T.
        alive: [S] bool, static points that are still static.
        offsets: Learned time offsets; None if they are not learned.
    """
    changes = [points.changes(frame) for frame in range(frames)]
    dx, dq = torch.stack([c.dx for c in changes]), torch.stack([c.dq for c in changes])
    logits = points.canonical.params["logit_opacities"]
    shades = [_shade(c.shade, logits) for c in changes if c.shade is not None]
    shade = torch.stack(shades).cpu().numpy() if shades else None
    arrays = dx.cpu().numpy(), dq.cpu().numpy(), alive.cpu().numpy()
    return GroupResult(points.canonical.gaussians(), *arrays, shade, offsets)


def _shade(shade: Tensor, logits: Tensor) -> Tensor:
    """Return [N, 4] as in `Group`: the change of the opacity instead of the change of its logit."""
    return torch.cat([shade[:, :3], ((logits + shade[:, 3]).sigmoid() - logits.sigmoid())[:, None]], 1)


class GroupTrainer:
    """Trainer of one group. Static points stay frozen unless density control makes them dynamic (paper section 4.1).

    Attributes:
        images: Images in use, smaller ones at first.
        larger_images: Images of larger sizes, each with the iteration at which its use begins.
    """

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
        losses: Sequence[Loss[GroupStep]] | None = None,
    ) -> None:
        """Prepare the training of a group.

        Args:
            images: Training images at full size.
            start: Initial state.
            static: Static points.
            config: Settings.
            gains: Color gains of the cameras.
            time_offsets: Time offsets of the cameras, to be refined; None if all cameras are synchronized.
            may_move: [S] bool, static points that density control may make dynamic; None allows all living points.
            seed: Seed of all random choices.
            missing: [T, C] bool, images that are not trained on; None trains on all.
            region: Volume in which points are cloned; None is everywhere.
            gpu: GPU that runs the iterations; None runs them on the device of the images.
            losses: List of losses; None is `losses.GROUP`.
        """
        device, group = images.pixels.device, config.group
        self.config = config
        self.losses = GROUP if losses is None else losses
        self.gains = gains
        self.iterations = group.iterations_per_frame * images.count
        sizes = images.sizes(self.iterations, group.coarse_share, config.training_megapixels)
        self.images = sizes[0][1]
        self.larger_images = [(end, larger) for (end, _), (_, larger) in pairwise(sizes)]
        self.time_offsets = time_offsets or TimeOffsets(len(images.views), enabled=False)
        self.points = DynamicPoints.of(start, self.images, group, seed)
        self.static = StaticCache(static.points, self.images.all_views, images.near, device)
        self.static.set_alive(torch.from_numpy(static.alive).to(device))
        available = np.ones((images.count, len(images.views)), bool) if missing is None else ~missing
        self.schedule = FrameSchedule(available, self.iterations, group.progressive_share, seed)
        self.rng = np.random.default_rng(seed)
        movable = torch.from_numpy(static.alive if may_move is None else may_move).to(device)
        self.density = GroupDensity(self.points, self.static, movable, config, self.iterations, self.rng, region)
        self.gpu = gpu
        self.program: GpuGroupProgram | CpuGroupProgram | None = None
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
                if self.program is not None:
                    self.start_program(progress)
            except GpuError as error:
                done = self._continue_without_gpu(error, progress)
        self.recovery.release_state()
        self.program = None
        quality = self.psnr()
        progress.update(self.iterations, moving=len(self.points), psnr=quality)
        progress.note(f"PSNR of the group's training images: {quality:.1f} dB")
        return self.result()

    def _iterate(self, iteration: int, progress: Progress) -> int:
        """Run one iteration, or several of a program, and the actions that are due after it.

        Returns:
            Number of finished iterations.

        Raises:
            GaussiansError: A value is NaN or infinite.
            GpuError: The GPU was lost, or has too little memory.
        """
        while self.larger_images and iteration >= self.larger_images[0][0]:
            self._use_images(self.larger_images.pop(0)[1])
        if self.program is None:
            loss, done = self.step(iteration), iteration + 1
        else:
            loss, done = self._run_batch(iteration, self.program)
        if done % GIVE_BACK_EVERY == 0:
            self.images.release_pages()
        self.recovery.check_iteration(done, loss, self)
        if self.density.update(done, self.images):
            self.find_neighbors()
            self._upload()
        if self._shows(done - 1) or done == self.iterations:
            self.points.check()
            progress.update(done, loss=float(loss), moving=len(self.points))
        return done

    def start_program(self, progress: Progress) -> None:
        """Choose what runs the iterations: the GPU if there is one, else the CPU, or torch where neither has a program."""
        learns_time = self.time_offsets.enabled and self.images.count > 1
        parts = self.points, self.density, self.images, self.config.group, self.losses, self.gains, learns_time
        state, on_cpu = GroupState(*parts), not self.images.pixels.is_cuda
        self.program, why = None, state.unsupported
        try:
            opened = None if self.gpu is None else self.gpu.open()
            if opened is not None and why is not None:
                progress.note(f"this group is trained on the CPU: {why}")
            elif opened is not None:
                self.program = GpuGroupProgram(opened, state)
            elif why is None and on_cpu:
                self.program = CpuGroupProgram(state)
            elif on_cpu and (unknown := unsupported_losses(self.losses, GROUP_COSTS)):
                progress.note(f"this group is trained with torch, which takes longer: {unknown}")
            self._upload()
        except GpuError as error:
            self._continue_without_gpu(error, progress)

    def _continue_without_gpu(self, error: GpuError, progress: Progress) -> int:
        """Return to the last good state, to continue on the CPU. Return the number of iterations that are done in it."""
        assert self.gpu is not None
        done = self.recovery.leave_gpu(self.gpu, error, progress)
        self.start_program(progress)
        return done

    def _upload(self) -> None:
        """Give the state to the program, if there is one."""
        if self.program is not None:
            self.program.neighbors = self.neighbors
            self.program.images = self.images
            self.program.upload()

    def _run_batch(self, first: int, program: GpuGroupProgram | CpuGroupProgram) -> tuple[Tensor, int]:
        """Run iterations of the program until something is due, or until a draw depends on the results of these.

        Returns:
            Loss [] of the last iteration, and the number of finished iterations.
        """
        most = min(MOST_DRAWS, self.time_offsets.independent) if program.learns_time else MOST_DRAWS
        draws = [self.plan(first)]
        while len(draws) < most and not self._stops(first + len(draws)):
            draws.append(self.plan(first + len(draws)))
        outcomes = program.run(draws)
        for step, outcome in zip(draws, outcomes, strict=True):
            if program.learns_time:
                self.time_offsets.note(step.camera, torch.tensor(outcome.slope), step.share)
            if not step.whole and not step.metered_static:
                self.schedule.record_loss(step.frame, step.camera, torch.tensor(outcome.loss))
        done = first + len(draws)
        if self._needs_host(done):
            program.give_meters()
            program.download()
        return torch.tensor(outcomes[-1].loss), done

    def _stops(self, done: int) -> bool:
        """Return whether a batch of the program ends after `done` iterations."""
        shown = self._shows(done - 1) or done % GIVE_BACK_EVERY == 0
        return shown or self._needs_host(done) or self.schedule.waits_for_losses(done)

    def _needs_host(self, done: int) -> bool:
        """Return whether the host needs the state after `done` iterations."""
        resizes = bool(self.larger_images) and done >= self.larger_images[0][0]
        saves = done >= self.recovery.next_save
        return resizes or saves or self.density.is_due(done) or done == self.iterations

    def plan(self, iteration: int) -> Draw:
        """Decide what an iteration of the program draws and compares, with the random choices of `step`."""
        frame, camera = self.schedule.draw(iteration)
        share, whole = iteration / self.iterations, self._shows(iteration)
        step = Draw(
            iteration=iteration,
            share=share,
            pace=self.recovery.pace,
            frame=frame,
            camera=camera,
            moment=self.time_offsets.moment(frame, camera, self.images.count),
            whole=whole,
            metered=self.density.measures(iteration),
            metered_static=not whole and self.density.measured_static(iteration) is not None,
            rank=None,
            span=None,
        )
        last, count = self.schedule.frontier(iteration), self.images.count
        weight = partial(weight_of, losses=self.losses, step=step, config=self.config.group)
        neighbors = self.neighbors if weight(rigidity) else None
        rank = None if neighbors is None else choose_rank(neighbors, self.rng)
        span = choose_span(frame, count, last, self.rng) if weight(smoothness) else None
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
        """Check all values.

        Raises:
            GaussiansError: If a value is NaN or infinite.
        """
        self.points.check()

    def step(self, iteration: int) -> Tensor:
        """Run one iteration on one image and return its photometric loss []."""
        share = iteration / self.iterations
        frame, camera = self.schedule.draw(iteration)
        last_frame = self.schedule.frontier(iteration)
        self.points.deformation.extend_to(last_frame)
        moment = self.time_offsets.moment(frame, camera, self.images.count)
        changes = self.points.changes(moment)
        if self.time_offsets.enabled:  # the hash grid's offsets are not leaf tensors
            changes.dx.retain_grad()
            changes.dq.retain_grad()

        shown, place = self.images.of_iteration(iteration)
        view, place = shown.views[camera], place + camera
        splats = self.points.splats(changes, view, self.images.near)
        static, also = self.static.view(place), self.density.measured_static(iteration)
        whole = self._shows(iteration)  # the reported loss covers the whole image
        if whole or shown.unknown is not None:
            drawing = draw(splats, view, static, whole or also is None)
            target = shown.target(frame, camera, drawing.image, self.gains.values[camera])
        else:
            drawing, target = moving_tiles(splats, view, static, also), shown.pixels[frame, camera]

        drawn = GroupStep(
            iteration=iteration,
            share=share,
            view=view,
            drawing=drawing,
            target=target,
            gain=self.gains.values[camera],
            lambda_dssim=self.config.group.lambda_dssim,
            unit=self.images.unit,
            points=self.points,
            changes=changes,
            neighbors=self.neighbors,
            frame=frame,
            frames=self.images.count,
            last=last_frame,
            rng=self.rng,
        )
        loss = reported_loss(backward(self.losses, drawn, self.config.group))

        self._learn_time_offset(camera, moment, changes, share)
        if not whole and also is None:  # otherwise the loss covers another set of pixels
            self.schedule.record_loss(frame, camera, loss)
        self.density.measure(iteration, drawing, view)
        self.points.step(share, self.recovery.pace)
        return loss

    def find_neighbors(self) -> None:
        """Find the neighbors of every point again, after points were added, removed or moved."""
        self.neighbors = Neighbors.of(self.points.means, NEIGHBORS)

    def result(self) -> GroupResult:
        """Return the trained points and their changes."""
        offsets = self.time_offsets.learned() if self.time_offsets.enabled else None
        found = group_result(self.points, self.images.count, self.static.alive, offsets)
        return replace(found, dynamic=replace(found.dynamic, near=self.images.near))

    def psnr(self) -> float:
        """Return the mean PSNR, dB, over a few training images."""
        return training_psnr(
            self.points, self.static, self.images, self.gains.values, self.time_offsets, self.schedule.available
        )

    def _use_images(self, images: TrainingImages) -> None:
        """Switch to images of another size."""
        self.images = images
        self.static.set_views(images.all_views)
        self.density.restart()
        self.find_neighbors()
        self._upload()

    def _learn_time_offset(self, camera: int, moment: float, changes: Changes, share: float) -> None:
        """Refine a camera's time offset by the derivative of the loss with respect to the moment that was drawn."""
        frames = self.images.count
        if not self.time_offsets.enabled or frames < 2:
            return
        if changes.dx.grad is not None:
            gained = slope(self.points.deformation, self.points.means, moment, frames, (changes.dx, changes.dq))
            self.time_offsets.note(camera, gained, share)

    def _shows(self, iteration: int) -> bool:
        return (iteration + 1) % SHOW_EVERY == 0
