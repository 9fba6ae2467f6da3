"""Group reconstruction (paper section 4.2): dynamic points and their deformation, fitted to all frames of one group."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from splatreel.config import Config
from splatreel.errors import GaussiansError
from splatreel.motion.lift import NEIGHBORS
from splatreel.progress import Progress
from splatreel.recon.cameras.color_gains import CameraGains
from splatreel.recon.cameras.time_offsets import TimeOffsets, slope
from splatreel.recon.deform.adam import Restore, together
from splatreel.recon.layering.tracking import GroupStart
from splatreel.recon.train.export import GroupResult, group_result, training_psnr
from splatreel.recon.train.group_density import GroupDensity
from splatreel.recon.train.losses import GROUP, GroupStep, backward
from splatreel.recon.train.moving import Changes, MovingPoints
from splatreel.recon.train.pictures import Pictures
from splatreel.recon.train.recovery import Recovery
from splatreel.recon.train.regularizers import Neighbors
from splatreel.recon.train.render import StaticCache, draw, moving_tiles
from splatreel.recon.train.schedule import FrameSchedule
from splatreel.scene.static_points import StaticPoints

GIVE_BACK_EVERY = 50
"""Iterations after which pages of pictures are given back: each looks at one picture, and may meet all of them."""
SHOW_EVERY = 50
"""Iterations between two that say their loss."""


class GroupTrainer:
    """One group's loop. Static points stay as they are, unless density control makes them dynamic (paper 4.1).

    pictures: those in use, at first smaller ones; coming: those of other sizes, and the iterations at whose number their turns come.
    """

    def __init__(
        self,
        pictures: Pictures,
        start: GroupStart,
        static: StaticPoints,
        config: Config,
        *,
        gains: CameraGains,
        time_offsets: TimeOffsets | None = None,
        may_move: np.ndarray | None = None,
        seed: int = 0,
    ) -> None:
        """time_offsets: to be learned further; None: all cameras are in step. may_move: [S] bool, the static points that density
        control may make dynamic; None: all that are alive."""
        device, group = pictures.images.device, config.group
        self.config, self.gains = config, gains
        self.iterations = group.iterations_per_frame * pictures.count
        sizes = pictures.sizes(self.iterations, group.coarse_share, config.training_megapixels)
        self.pictures = sizes[0][1]
        self.coming = [(end, larger) for (end, _), (_, larger) in pairwise(sizes)]
        self.time_offsets = time_offsets or TimeOffsets(len(pictures.views), enabled=False)
        self.points = MovingPoints.of(start, self.pictures, group, seed)
        self.static = StaticCache(static.points, self.pictures.views, pictures.near, device)
        self.static.set_alive(torch.from_numpy(static.alive).to(device))
        self.schedule = FrameSchedule(
            pictures.count, len(pictures.views), self.iterations, group.progressive_share, seed
        )
        self.rng = np.random.default_rng(seed)
        movable = torch.from_numpy(static.alive if may_move is None else may_move).to(device)
        self.density = GroupDensity(self.points, self.static, movable, config, self.iterations, self.rng)
        self.find_neighbors()
        self.recovery = Recovery()

    def train(self, progress: Progress) -> GroupResult:
        if len(self.points) == 0:
            progress.note("nothing moves in this group: it has no points of its own")
            return self.result()
        done = 0
        self.recovery.keep(done, self)
        while done < self.iterations:
            try:
                self._iterate(done, progress)
                done += 1
            except GaussiansError as error:
                done = self.recovery.go_back(done + 1, error, progress)
        self.recovery.drop()
        progress.note(f"the pictures that this group was trained on come out with {self.psnr():.1f} dB")
        return self.result()

    def _iterate(self, iteration: int, progress: Progress) -> None:
        """A step, and what is to be done after it. Raises `GaussiansError` where numbers are not finite."""
        while self.coming and iteration >= self.coming[0][0]:
            self._use(self.coming.pop(0)[1])
        loss, done = self.step(iteration), iteration + 1
        if done % GIVE_BACK_EVERY == 0:
            self.pictures.give_back()
        self.recovery.passed(done, loss, self)
        if self.density.update(done, self.pictures):
            self.find_neighbors()
        if self._shows(iteration) or done == self.iterations:
            self.points.check()
            progress.update(done, loss=float(loss), moving=len(self.points))

    def snapshot(self) -> Restore:
        """All that training changes, copied."""
        parts = together([self.points.snapshot(), self.time_offsets.snapshot()])
        alive, budget = self.static.alive, self.density.budget

        def restore() -> None:
            parts()
            self.static.revive(alive)
            self.density.budget = budget
            self.density.restart()
            self.find_neighbors()

        return restore

    def check(self) -> None:
        """Raises `GaussiansError` if a value is NaN or infinite."""
        self.points.check()

    def step(self, iteration: int) -> Tensor:
        """One iteration: draw what one camera saw of one frame, compare, follow the gradients. Returns its photometric loss []."""
        share = iteration / self.iterations
        frame, camera = self.schedule.draw(iteration)
        last_frame = self.schedule.frontier(iteration)
        self.points.deformation.extend_to(last_frame)
        moment = self.time_offsets.moment(frame, camera, self.pictures.count)
        changes = self.points.changes(moment)
        if self.time_offsets.enabled:  # of the hash grid they are no leaves
            changes.dx.retain_grad()
            changes.dq.retain_grad()

        view = self.pictures.views[camera]
        splats = self.points.splats(changes, view, self.pictures.near)
        static, also = self.static.view(camera), self.density.measured_static(iteration)
        whole = self._shows(iteration)  # only to be looked at
        drawing = draw(splats, view, static) if whole else moving_tiles(splats, view, static, also)

        drawn = GroupStep(
            iteration=iteration,
            share=share,
            view=view,
            drawing=drawing,
            target=self.pictures.images[frame, camera],
            gain=self.gains.values[camera],
            lambda_dssim=self.config.group.lambda_dssim,
            unit=self.pictures.unit,
            points=self.points,
            changes=changes,
            neighbors=self.neighbors,
            frame=frame,
            frames=self.pictures.count,
            last=last_frame,
            rng=self.rng,
        )
        loss = backward(GROUP, drawn, self.config.group)["photometric"].detach()

        self._learn_time_offset(camera, moment, changes, share)
        if not whole and also is None:  # else it is the loss of another set of pixels
            self.schedule.note(frame, camera, loss)
        self.density.measure(iteration, drawing, view)
        self.points.step(share, self.recovery.pace)
        return loss

    def find_neighbors(self) -> None:
        """Of every point, after points have come, gone or moved."""
        self.neighbors = Neighbors.of(self.points.means, NEIGHBORS)

    def result(self) -> GroupResult:
        return group_result(self.points, self.pictures.count, self.static.alive, self.time_offsets.learned())

    def psnr(self) -> float:
        """Mean dB over a few of the pictures that are trained on."""
        return training_psnr(self.points, self.static, self.pictures, self.gains.values, self.time_offsets)

    def _use(self, pictures: Pictures) -> None:
        """From now on, those of another size."""
        self.pictures = pictures
        self.static.set_views(pictures.views)
        self.density.restart()
        self.find_neighbors()

    def _learn_time_offset(self, camera: int, moment: float, changes: Changes, share: float) -> None:
        """When a camera took its picture, by how the loss changes with the moment that was drawn."""
        frames = self.pictures.count
        if not self.time_offsets.enabled or frames < 2:
            return
        d_dx, d_dq = changes.dx.grad, changes.dq.grad
        if d_dx is not None and d_dq is not None:
            gained = slope(self.points.deformation, self.points.means, moment, frames, d_dx, d_dq)
            self.time_offsets.note(camera, gained, share)

    def _shows(self, iteration: int) -> bool:
        return (iteration + 1) % SHOW_EVERY == 0
