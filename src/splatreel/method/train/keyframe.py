"""Training of a keyframe with 3DGS, from sparse points or from the previous group (paper section 5.1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from splatreel.base.errors import GaussiansError
from splatreel.base.progress import Progress
from splatreel.config import KeyframeConfig
from splatreel.kernels import splat
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.deform.adam import Restore, merge_snapshots
from splatreel.method.train.density import KeyframeDensity
from splatreel.method.train.error_points import ADDED_AT, ADDED_SHARE, points_at_errors
from splatreel.method.train.losses import KEYFRAME, KeyframeStep, Loss, backward, psnr
from splatreel.method.train.pictures import Pictures
from splatreel.method.train.points import TrainablePoints, default_rates
from splatreel.method.train.recovery import Recovery
from splatreel.method.train.render import Comparable, Splats, StaticCache, View, deformed, draw, moving_tiles
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.volumes import Volume

SHOW_EVERY = 25
"""Iterations between two progress updates."""
GAINS_EVERY = 4
"""Iterations between two comparisons of whole images in front of static points, which the color gains are learned from. Other
iterations compare only tiles with moving points."""

LAMBDA_DSSIM = 0.2
"""Weight of structural similarity in the photometric loss, as in 3DGS."""
AVERAGE_EVERY = 4
"""Iterations between two samples of the mean. Neighboring iterations hardly differ."""


class Average:
    """Running mean of tensors over the last `share` of the iterations. It restarts when rows are added or removed.

    Source:
        Polyak averaging; for networks, Izmailov et al. 2018.
    """

    def __init__(self, share: float, iterations: int) -> None:
        """Prepare an average.

        Args:
            share: Share of the iterations that is averaged.
            iterations: Iterations of training.
        """
        self.after = iterations - round(share * iterations)
        self._means: list[Tensor] = []
        self._count = 0

    def has_begun(self, done: int) -> bool:
        """Return whether averaging has begun. done: number of finished iterations."""
        return done > self.after

    @torch.no_grad()
    def add(self, done: int, tensors: Iterable[Tensor]) -> None:
        """Add the values after an iteration."""
        if done % AVERAGE_EVERY:
            return
        now = [tensor.detach() for tensor in tensors]
        if [mean.shape for mean in self._means] != [tensor.shape for tensor in now]:
            self._means, self._count = [tensor.clone() for tensor in now], 0
        self._count += 1
        for mean, tensor in zip(self._means, now, strict=True):
            mean.lerp_(tensor, 1 / self._count)

    @torch.no_grad()
    def write_to(self, tensors: Iterable[Tensor]) -> None:
        """Write the mean to the tensors, if it has their shapes."""
        now = list(tensors)
        if [mean.shape for mean in self._means] == [tensor.shape for tensor in now]:
            for tensor, mean in zip(now, self._means, strict=True):
                tensor.copy_(mean)


@dataclass(frozen=True)
class KeyframeResult:
    """Result of a keyframe's training.

    Attributes:
        points: Gaussians of the keyframe.
        gains: [C, 3] float32, learned color gains of the cameras.
        alive: [S] bool, static points that the first keyframe of a chapter keeps; None for all other keyframes, which keep all.
    """

    points: Gaussians
    gains: np.ndarray
    alive: np.ndarray | None = None


def starting_points(
    positions: np.ndarray, colors: np.ndarray, config: KeyframeConfig, unit: float, device: torch.device
) -> TrainablePoints:
    """Create Gaussians at sparse points, as large as the distance to their neighbors.

    Args:
        positions: [P, 3] world.
        colors: [P, 3] 0..1.
        config: Keyframe settings.
        unit: Typical viewing distance, world units.
        device: Device of the tensors.

    Source:
        3DGS, section 5.1.
    """
    points = torch.from_numpy(np.asarray(positions, np.float32)).to(device)
    neighbors = min(3, len(points) - 1)
    if neighbors > 0:
        distances = splat.nearest_neighbors(points, neighbors)[1]
        size = distances.square().mean(1).sqrt().clamp(2e-3 * unit, 0.07 * unit)
    else:
        size = torch.full((len(points),), 0.02 * unit, device=device)
    count = len(points)
    quats = torch.zeros(count, 4, device=device)
    quats[:, 0] = 1
    base = (torch.from_numpy(np.asarray(colors, np.float32)).to(device) - 0.5) / C0
    params = {
        "means": points,
        "quats": quats,
        "log_scales": size.log()[:, None].repeat(1, 3),
        "logit_opacities": torch.full((count,), math.log(0.1 / 0.9), device=device),
        "sh_base": base[:, None],
        "sh_rest": torch.zeros(count, (config.sh_degree + 1) ** 2 - 1, 3, device=device),
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
        losses: Sequence[Loss[KeyframeStep]] = KEYFRAME,
        seed: int = 0,
        region: Volume | None = None,
    ) -> None:
        """Prepare the training of a keyframe.

        Args:
            points: Points to train.
            gains: Color gains of the cameras, trained too.
            config: Keyframe settings.
            static: Frozen static points; None if there are none.
            max_points: Maximum number of points.
            losses: List of losses.
            seed: Seed of all random choices.
            region: Volume in which points are densified; None is everywhere.
        """
        self.points, self.gains, self.config, self.static, self.losses = points, gains, config, static, losses
        self.density = KeyframeDensity(points, config, max_points, seed, region)
        self.rng = np.random.default_rng(seed)
        self.done = 0
        self.recovery = Recovery()
        self.watch: Callable[[Callable[[], Gaussians]], None] | None = None
        """Called during training with a function that returns the points as they are now."""

    def train(self, pictures: Pictures, iterations: int, total: int, progress: Progress) -> None:
        """Run `iterations` of `total` on images of one resolution. Another call continues with other images."""
        static = self._static_cache(pictures)
        average = Average(self.config.average_share, total)
        self.density.restart(pictures)
        end, cameras = self.done + iterations, list[int]()
        self.recovery.save_state(self.done, self)
        while self.done < end:
            cameras = cameras or self.rng.permutation(len(pictures.views)).tolist()
            camera = cameras.pop()
            try:
                loss, drawing = self.step(pictures, camera, static, self.done / total)
                self.done += 1
                self.recovery.check_iteration(self.done, loss, self)
                share, averaged = self.done / total, average.has_begun(self.done)
                self._anneal(share)
                self.density.update(self.done, share, drawing, pictures.views[camera], pictures, averaged)
                if self._adds_at_errors(total):
                    self._add_at_errors(pictures)
                if averaged:
                    average.add(self.done, self.points.params.values())
                if self.done % SHOW_EVERY == 0 or self.done == end:
                    self.check()
                    progress.update(self.done, loss=float(loss), points=len(self.points))
                    if self.watch is not None:
                        self.watch(self.points.gaussians)
            except GaussiansError as error:
                self.done = self.recovery.restore(self.done, error, progress)
                self._anneal(self.done / total)
                self.density.restart(pictures)
                average = Average(self.config.average_share, total)
        self.recovery.release_state()
        average.write_to(self.points.params.values())
        self.density.prune(pictures.unit, self.done / total)

    def snapshot(self) -> Restore:
        """Copy everything that training changes."""
        return merge_snapshots([self.points.snapshot(), self.gains.snapshot()])

    def check(self) -> None:
        """Check all values.

        Raises:
            GaussiansError: If a value is NaN or infinite.
        """
        self.points.check()
        splat.check_finite(gains=self.gains.values)

    def step(
        self, pictures: Pictures, camera: int, static: StaticCache | None, share: float
    ) -> tuple[Tensor, Comparable]:
        """Run one iteration: draw a view, compare it and follow the gradients.

        Args:
            pictures: Training images.
            camera: Number of the camera.
            static: Static points; None if there are none.
            share: Share of training that is over, 0..1.

        Returns:
            The photometric loss [], and the drawing with its gradients.
        """
        view = pictures.views[camera]
        splats = deformed(self.points.params, None, None, view, pictures.near)
        if static is None or self._compares_all(pictures):
            splats, gain = _with_gain(splats, view, self.gains.of(camera))
            drawing = draw(splats, view, static.view(camera) if static else None)
            target = pictures.target(camera, drawing.image, gain)
        else:
            splats, gain = _with_gain(splats, view, self.gains.values[camera])
            drawing, target = moving_tiles(splats, view, static.view(camera)), pictures.images[0, camera]
        drawn = KeyframeStep(
            iteration=self.done,
            share=share,
            view=view,
            drawing=drawing,
            target=target,
            gain=gain,
            lambda_dssim=LAMBDA_DSSIM,
            unit=pictures.unit,
            points=self.points,
            splats=splats,
            near=pictures.near,
        )
        losses = backward(self.losses, drawn, self.config)
        self.points.step(self.density.distances[:, None])
        self.gains.step()
        return losses["photometric"].detach(), drawing

    @torch.no_grad()
    def psnr(self, pictures: Pictures) -> float:
        """Return the mean PSNR, dB, over the training images, without static points."""
        images = [self._draw(pictures, camera)[1] for camera in range(len(pictures.views))]
        return float(np.mean([psnr(image, target) for image, target in zip(images, pictures.images[0], strict=True)]))

    def _draw(self, pictures: Pictures, camera: int) -> tuple[Splats, Tensor]:
        """Return the projected points of a camera, without static points, and the image [H, W, 3] that the camera would take."""
        view, gain = pictures.views[camera], self.gains.values[camera]
        splats, factor = _with_gain(deformed(self.points.params, None, None, view, pictures.near), view, gain)
        image = draw(splats, view).image
        return splats, image if factor is None else image * factor

    def _adds_at_errors(self, total: int) -> bool:
        """Return whether points are added at errors now, in a training of `total` iterations."""
        return self.config.detail and self.static is None and self.done in [round(at * total) for at in ADDED_AT]

    def _add_at_errors(self, pictures: Pictures) -> None:
        """Add points where the images differ most from the drawings."""
        count = max(min(self.density.room, round(ADDED_SHARE * len(self.points))), 0)
        bands, gains = self.points.params["sh_rest"].shape[1], self.gains.values
        draw_camera = partial(self._draw, pictures)
        self.density.add(points_at_errors(draw_camera, pictures, gains, bands, count, self.rng), pictures)

    def _static_cache(self, pictures: Pictures) -> StaticCache | None:
        if self.static is None or len(self.static) == 0:
            return None
        return StaticCache(self.static, pictures.views, pictures.near, self.points.means.device)

    def _compares_all(self, pictures: Pictures) -> bool:
        """Return whether the next iteration compares the whole image."""
        shows = (self.done + 1) % SHOW_EVERY == 0
        return shows or self.done % GAINS_EVERY == 0 or pictures.unknown is not None

    def _anneal(self, share: float) -> None:
        late, pace = 0.3 if share > 0.8 else 1.0, self.recovery.pace
        factors = {"means": 0.02**share, "quats": 1.0, "log_scales": 0.2 if share > 0.8 else 1.0}
        self.points.scale_rates({name: pace * factor for name, factor in factors.items()}, default=pace * late)


def _with_gain(splats: Splats, view: View, gain: Tensor | None) -> tuple[Splats, Tensor | None]:
    """Return the splats to draw, and the factor [3] on the drawing, for a camera's color gain [3]; None is 1.

    A background without a gain was divided by the gain that was known when the view was made. The splats then carry the rest of
    the gain, so that the gain is learned from them alone.
    """
    if view.gain is None or gain is None:
        return splats, gain
    return splats.with_gain(gain / view.gain, view.background), view.gain
