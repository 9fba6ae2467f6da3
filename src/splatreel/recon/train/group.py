"""Group reconstruction (paper section 4.2): dynamic points and their deformation, fitted to all frames of one group."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from splatreel.config import Config
from splatreel.kernels import splat
from splatreel.motion.lift import NEIGHBORS
from splatreel.progress import Progress
from splatreel.recon.cameras.color_gains import CameraGains
from splatreel.recon.cameras.time_offsets import TimeOffsets, slope
from splatreel.recon.deform.appearance import Appearance, detect_cuts
from splatreel.recon.deform.hashgrid import HashGrid
from splatreel.recon.deform.protocol import Deformation
from splatreel.recon.deform.trajectory import Trajectory
from splatreel.recon.layering.tracking import Start
from splatreel.recon.train import losses
from splatreel.recon.train.density import CULL_OPACITY, GradientMeter, too_large
from splatreel.recon.train.points import TrainablePoints
from splatreel.recon.train.render import (
    Drawing,
    Splats,
    StaticCache,
    View,
    contributions,
    deformed,
    draw,
    halved,
    relative_distances,
)
from splatreel.recon.train.schedule import FrameSchedule
from splatreel.scene.gaussians import Gaussians

CANONICAL_RATES = {
    "means": 3.6e-4,
    "quats": 8e-3,
    "log_scales": 2.4e-2,
    "logit_opacities": 8e-2,
    "sh_base": 1.6e-2,
    "sh_rest": 4e-4,
}
"""Means per viewing distance. Bolder than a keyframe's: what moves is hidden at times, and what appeared was only guessed."""


ADAPT_FROM, ADAPT_TO = 0.25, 0.8
"""Share of training in which points are converted and cloned: before, everything that moves pulls; after, none could learn."""

FULL_WIDTH = 1352
"""Image width that the paper's thresholds are for."""

FAINT_AT = (0.4, 0.7)
"""Shares of training after which the faintest points go: what guessed the wrong place has faded by then, and the rest can fill in."""

FAINT_PICTURES = 60
"""Pictures in which that is measured."""

MEASURE_EVERY = 8
"""Iterations between two that draw the whole picture, to measure how much the static points are pulled at."""

TEMPORAL_WINDOW = 2
"""Frames over which motion is to be smooth: the paper's number (section 5.1)."""

SHOW_EVERY = 50
"""Iterations between two that say their loss."""


@dataclass(frozen=True)
class GroupFrames:
    """All that a group is fitted to. images: [T, C, H, W, 3] uint8. unit, near: world units."""

    images: Tensor
    views: list[View]
    near: float
    unit: float

    @property
    def count(self) -> int:
        return self.images.shape[0]

    def halved(self) -> GroupFrames:
        """The same at half size. A frame at a time, into its place: as floats, or in pieces, a group's pictures take much memory."""
        count, cameras, height, width, channels = self.images.shape
        small = self.images.new_empty(count, cameras, height // 2, width // 2, channels)
        for place, images in zip(small, self.images, strict=True):
            place.copy_(halved(images))
        return replace(self, images=small, views=[view.halved() for view in self.views])


@dataclass(frozen=True)
class GroupResult:
    """dynamic: canonical points; dx: [T, N, 3], dq: [T, N, 4] at every frame; alive: [S] bool over the static points.

    shade: [T, N, 4] as in `Group`, or None.
    """

    dynamic: Gaussians
    dx: np.ndarray
    dq: np.ndarray
    alive: np.ndarray
    shade: np.ndarray | None


class GroupTrainer:
    """One group's loop. Static points stay as they are, unless adaptive conversion makes them dynamic (paper 4.1)."""

    def __init__(
        self,
        frames: GroupFrames,
        start: Start,
        static: Gaussians,
        alive: np.ndarray,
        gains: CameraGains,
        config: Config,
        seed: int,
        convertible: np.ndarray | None = None,
        delays: TimeOffsets | None = None,
    ) -> None:
        device = frames.images.device
        self.delays = delays or TimeOffsets(len(frames.views), enabled=False)
        self.config, self.gains, self.whole = config, gains, frames
        self.frames = frames = frames.halved() if config.group.coarse_share else frames
        rates = CANONICAL_RATES | {"means": CANONICAL_RATES["means"] * frames.unit}
        self.points = TrainablePoints.from_gaussians(start.dynamic, rates, device)
        self.backdrop = StaticCache(static, frames.views, frames.near, device)
        self.backdrop.set_alive(torch.from_numpy(alive).to(device))
        self.convertible = torch.from_numpy(alive if convertible is None else convertible).to(device)
        tracks, shades = (None if a is None else torch.from_numpy(a).to(device) for a in (start.tracks, start.shades))
        fixed = None if shades is None else shades.any(2).any(0)
        self.model = make_deformation(config.group.deformation, self.points.means.detach(), frames, seed, tracks, fixed)
        self.shade = None
        if config.group.appearance:
            self.shade = Appearance(frames.count, len(self.points), device, shades, detect_cuts(frames.images))
        self.iterations = config.group.iterations_per_frame * frames.count
        self.schedule = FrameSchedule(
            frames.count, len(frames.views), self.iterations, config.group.progressive_share, seed
        )
        self.rng = np.random.default_rng(seed)
        self.room = max(2000, len(self.points) // 2)
        self._watch()

    def train(self, progress: Progress) -> GroupResult:
        if len(self.points) == 0:
            progress.note("nothing moves in this group: it has no points of its own")
            return self.result()
        layering = self.config.layering
        culls = {round(at * self.iterations) for at in FAINT_AT} if self.config.group.faint_share else set()
        fine = round(self.config.group.coarse_share * self.iterations)
        for iteration in range(self.iterations):
            if iteration == fine:
                self._refine()
            loss = self._step(iteration)
            share = (iteration + 1) / self.iterations
            if layering.adapt_every and (iteration + 1) % layering.adapt_every == 0:
                if ADAPT_FROM <= share <= ADAPT_TO:
                    self._adapt()
                self._prune()
                self._watch()
            if iteration + 1 in culls:
                self._drop_faint()
                self._watch()
            if (iteration + 1) % SHOW_EVERY == 0 or share == 1:
                self.points.check()
                progress.update(iteration + 1, loss=float(loss), moving=len(self.points))
        progress.note(f"the pictures that this group was trained on come out with {self.psnr():.1f} dB")
        return self.result()

    def _step(self, iteration: int) -> Tensor:
        share = iteration / self.iterations
        frame, camera = self.schedule.draw(iteration)
        self.model.extend_to(self.schedule.frontier(iteration))
        view = self.frames.views[camera]
        moment = self.delays.moment(frame, camera, self.frames.count)
        dx, dq = self.model.offsets(self.points.means, moment)
        if self.delays.enabled:  # of the hash grid they are no leaves
            dx.retain_grad()
            dq.retain_grad()
        shade = None if self.shade is None else self.shade.at(moment)
        moving = self._deformed(dx, dq, shade, view)
        every = self.config.layering.adapt_every
        adapts = every > 0 and ADAPT_FROM <= (iteration // every + 1) * every / self.iterations <= ADAPT_TO
        measured = adapts and iteration % MEASURE_EVERY == 0
        drawing = draw(moving, view, self.backdrop.view(camera), layered=not measured)
        target, gain = self.frames.images[frame, camera], self.gains.values.detach()[camera]
        tiles = drawing.tiles
        if (iteration + 1) % SHOW_EVERY == 0:
            tiles = None  # the whole loss is only there to be looked at
        loss = splat.photometric_loss(drawing.image, target, self.config.group.lambda_dssim, gain, tiles)
        torch.autograd.backward([loss, *self._regularisers(iteration, frame, dx, dq)])
        if self.delays.enabled and self.frames.count > 1 and dx.grad is not None and dq.grad is not None:
            gradients = dx.grad, dq.grad
            self.delays.note(camera, slope(self.model, self.points.means, moment, self.frames.count, *gradients), share)
        if tiles is not None:  # else it is the loss of another set of pixels
            self.schedule.note(frame, camera, loss)
        if adapts:  # nobody asks otherwise
            self._measure(drawing, view, measured)
        self.points.price_sh(self.config.group.lambda_sh / (view.width * view.height))
        self.points.scale_rates({}, default=0.1**share)
        self.points.step()
        self.model.step(share)
        if self.shade is not None:
            self.shade.step(share)
        return loss.detach()

    def _refine(self) -> None:
        """Go on with pictures of full size."""
        if self.frames is not self.whole:
            self.frames = self.whole
            self.backdrop.set_views(self.whole.views)
            self._watch()

    def _deformed(self, dx: Tensor, dq: Tensor, shade: Tensor | None, view: View) -> Splats:
        return deformed(self.points.params, (dx, dq), shade, view, self.frames.near)

    def _at(self, frame: float, view: View) -> Splats:
        """The moving points at a frame, as a view sees them."""
        shade = None if self.shade is None else self.shade.at(frame)
        return self._deformed(*self.model.offsets(self.points.means, frame), shade, view)

    def _regularisers(self, iteration: int, frame: int, dx: Tensor, dq: Tensor) -> list[Tensor]:
        """ARAP on one random neighbour of every point in every second iteration, temporal smoothness in every eighth.

        Both are weighted up in turn: unbiased, and cheap.
        """
        group, costs = self.config.group, []
        if group.lambda_arap and len(self.points) > 1 and iteration % 2 == 0:
            rank = int(self.rng.integers(len(self.neighbours)))
            other, weights = self.neighbours[rank], self.pair_weights[rank]
            costs.append(losses.arap(self.points.means, dx, dq, other, weights, self.frames.unit))
        if group.lambda_temporal and self.frames.count > 2 and iteration % 8 == 1:
            last = min(self.schedule.frontier(iteration), self.frames.count - 1)
            start = min(frame, max(last - TEMPORAL_WINDOW, 0))
            end = min(start + TEMPORAL_WINDOW, last)
            if end > start:
                delta = float(self.rng.uniform())
                smooth = losses.temporal(self.model, self.points.means, start, end, delta, self.frames.unit)
                costs.append(8 * group.lambda_temporal * smooth)
        return costs

    def _measure(self, drawing: Drawing, view: View, everything: bool) -> None:
        grad = drawing.means2d.grad
        assert grad is not None
        self.moving_meter.add(grad[: drawing.moving], view.width, view.height)
        if everything and drawing.index is not None:
            self.static_meter.add(grad[drawing.moving :], view.width, view.height, drawing.index)

    def _watch(self) -> None:
        """Start the meters anew and find every point's neighbours, after the set of points has changed."""
        device, count = self.points.means.device, len(self.points)
        self.moving_meter = GradientMeter(count, device)
        self.static_meter = GradientMeter(len(self.backdrop), device)
        if count > 1:
            k = min(NEIGHBORS, count - 1)
            neighbours, distance = splat.nearest_neighbours(self.points.means.detach(), k)
            reach = 2 * distance[:, -1:].median().clamp_min(1e-9)
            closeness = torch.exp(-((distance / reach) ** 2))  # rows of one rank each, as an iteration draws them
            self.neighbours = neighbours.T.contiguous()
            self.pair_weights = (2 * self.config.group.lambda_arap * closeness).T.contiguous()

    def _adapt(self) -> None:
        """Adaptive static-point conversion (paper 4.1), then clone dynamic points that the images still pull at (4.2)."""
        layering = self.config.layering
        alive = self.backdrop.alive
        coarseness = FULL_WIDTH / self.frames.views[0].width
        convert = alive & (self.static_meter.mean() > layering.adapt_gradient * coarseness)
        convert |= alive & self._surrounded(alive)
        chosen = torch.nonzero(convert & self.convertible)[:, 0]
        if len(chosen) > self.room:
            chosen = chosen[torch.topk(self.static_meter.mean()[chosen], self.room).indices]
        grow = self.moving_meter.mean() > layering.adapt_gradient * coarseness
        clones = torch.nonzero(grow)[:, 0]
        if len(clones) > max(self.room - len(chosen), 0):
            clones = clones[torch.topk(self.moving_meter.mean()[clones], max(self.room - len(chosen), 0)).indices]
        self.room -= len(chosen) + len(clones)
        self._clone(clones)
        self._convert(chosen)

    def _surrounded(self, alive: Tensor) -> Tensor:
        """[S] bool: static points with more than lambda_adp^nn of their nearest neighbours dynamic."""
        index = torch.nonzero(alive)[:, 0]
        everything = torch.cat([self.backdrop.means[index], self.points.means.detach()])
        k = min(NEIGHBORS, len(everything) - 1)
        surrounded = torch.zeros_like(alive)
        if len(index) and k > 0:
            neighbours = splat.nearest_neighbours(everything, k)[0][: len(index)]
            dynamic = (neighbours >= len(index)).float().mean(1)
            surrounded[index] = dynamic > self.config.layering.adapt_neighbors
        return surrounded

    def _clone(self, index: Tensor) -> None:
        if len(index):
            rows = self.points.rows(index)
            self.points.append(rows)
            self.model.append(rows["means"], index)
            if self.shade is not None:
                self.shade.append(len(index), index)

    def _convert(self, index: Tensor) -> None:
        if len(index):
            rows = {name: value[index] for name, value in self.backdrop.params.items()}
            alive = self.backdrop.alive.clone()
            alive[index] = False
            self.backdrop.set_alive(alive)
            self.points.append(rows)
            self.model.append(rows["means"], None)
            if self.shade is not None:
                self.shade.append(len(index), None)

    def _prune(self) -> None:
        """Drop what hardly shows and what is absurdly large for where it is; far walls and trees are large, and would leave holes."""
        frames, config = self.frames, self.config.keyframe
        with torch.no_grad():
            highest = 0 if self.shade is None else self.shade.highest
            opacities = (self.points.params["logit_opacities"] + highest).sigmoid()
            keep = opacities >= CULL_OPACITY
            farther = relative_distances(self.points.means, frames.views, frames.unit, config.far_step_scale)
            keep &= ~too_large(self.points.scales, farther, frames.unit)
        if not bool(keep.all()) and bool(keep.any()):
            self._keep(torch.nonzero(keep)[:, 0])

    def _drop_faint(self) -> None:
        """Drop the points that together fill next to nothing of the pictures: often half of all, and each costs bytes and time."""
        total = torch.zeros(len(self.points), device=self.points.means.device)
        for k in range(FAINT_PICTURES):
            frame = k * (self.frames.count - 1) // (FAINT_PICTURES - 1)
            camera = int(self.rng.integers(len(self.frames.views)))
            view = self.frames.views[camera]
            with torch.no_grad():
                moving = self._at(frame, view)
            total += contributions(moving, view, self.backdrop.view(camera))
        order = total.argsort()
        held = total[order].cumsum(0) / total.sum().clamp_min(1e-9)
        self._keep(order[held >= self.config.group.faint_share].sort().values)

    def _keep(self, index: Tensor) -> None:
        if len(index):
            self.points.keep(index)
            self.model.keep(index)
            if self.shade is not None:
                self.shade.keep(index)

    @torch.no_grad()
    def psnr(self, samples: int = 12) -> float:
        """Mean PSNR over a few training images spread over the group's frames and cameras."""
        values = []
        for k in range(samples):
            frame = k * (self.frames.count - 1) // max(samples - 1, 1)
            camera = (k * 7) % len(self.frames.views)
            view = self.frames.views[camera]
            moment = self.delays.moment(frame, camera, self.frames.count)
            image = draw(self._at(moment, view), view, self.backdrop.view(camera)).image
            values.append(losses.psnr(image * self.gains.values[camera], self.frames.images[frame, camera]))
        return float(np.mean(values))

    @torch.no_grad()
    def result(self) -> GroupResult:
        offsets = [self.model.offsets(self.points.means, frame) for frame in range(self.frames.count)]
        dx = torch.stack([o[0] for o in offsets]).cpu().numpy()
        dq = torch.stack([o[1] for o in offsets]).cpu().numpy()
        return GroupResult(self.points.gaussians(), dx, dq, self.backdrop.alive.cpu().numpy(), self._shades())

    def _shades(self) -> np.ndarray | None:
        if self.shade is None:
            return None
        logits, rows = self.points.params["logit_opacities"], []
        for frame in range(self.frames.count):
            shade = self.shade.at(frame)
            rows.append(torch.cat([shade[:, :3], ((logits + shade[:, 3]).sigmoid() - logits.sigmoid())[:, None]], 1))
        return torch.stack(rows).cpu().numpy()


def make_deformation(
    name: str,
    means: Tensor,
    frames: GroupFrames,
    seed: int,
    tracks: Tensor | None = None,
    fixed: Tensor | None = None,
) -> Deformation:
    """The deformation model of a name, `trajectory` or `hashgrid`. tracks: [T, N, 3] positions to start from; fixed: [N] bool."""
    model = HashGrid if name == "hashgrid" and len(means) else Trajectory
    return model(means, frames.count, frames.unit, seed, tracks, fixed)
