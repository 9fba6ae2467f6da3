"""Static reconstruction of a keyframe: 3DGS, from sparse points or from the previous group (paper section 5.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from splatreel.config import KeyframeConfig
from splatreel.errors import GaussiansError
from splatreel.kernels import splat
from splatreel.progress import Progress
from splatreel.recon.cameras.color_gains import CameraGains
from splatreel.recon.deform.adam import Restore, together
from splatreel.recon.train.average import Average
from splatreel.recon.train.keyframe_density import KeyframeDensity
from splatreel.recon.train.losses import KEYFRAME, KeyframeStep, Loss, backward, psnr
from splatreel.recon.train.pictures import Pictures
from splatreel.recon.train.points import TrainablePoints, default_rates
from splatreel.recon.train.recovery import Recovery
from splatreel.recon.train.render import Comparable, StaticCache, deformed, draw, moving_tiles
from splatreel.scene.gaussians import C0, Gaussians

SHOW_EVERY = 25
"""Iterations between two that say their loss."""
GAINS_EVERY = 4
"""Iterations between two that compare whole pictures before static points, which the color gains are learned from; others look only
where something moves."""

LAMBDA_DSSIM = 0.2
"""Share of structural similarity in the photometric loss, as in 3DGS."""


@dataclass(frozen=True)
class KeyframeResult:
    """points: the Gaussians of a keyframe. gains: [C, 3] float32, the cameras' color gains that were learned with them."""

    points: Gaussians
    gains: np.ndarray


def starting_points(
    positions: np.ndarray, colors: np.ndarray, config: KeyframeConfig, unit: float, device: torch.device
) -> TrainablePoints:
    """Gaussians at sparse points, as large as the distance to their neighbors (3DGS section 5.1).

    positions: [P, 3] world. colors: [P, 3] 0..1.
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
    """Optimizes points on the images of one frame, before frozen static ones if there are any. Adds points in the first iterations."""

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
    ) -> None:
        self.points, self.gains, self.config, self.static, self.losses = points, gains, config, static, losses
        self.density = KeyframeDensity(points, config, max_points, seed)
        self.rng = np.random.default_rng(seed)
        self.done = 0
        self.recovery = Recovery()

    def train(self, pictures: Pictures, iterations: int, total: int, progress: Progress) -> None:
        """Run `iterations` of `total` on pictures of one resolution; call again with others to go on."""
        static = self._static_cache(pictures)
        average = Average(self.config.average_share, total)
        self.density.restart(pictures)
        end, cameras = self.done + iterations, list[int]()
        self.recovery.keep(self.done, self)
        while self.done < end:
            cameras = cameras or self.rng.permutation(len(pictures.views)).tolist()
            camera = cameras.pop()
            try:
                loss, drawing = self.step(pictures, camera, static, self.done / total)
                self.done += 1
                self.recovery.passed(self.done, loss, self)
                share, averaged = self.done / total, average.runs(self.done)
                self._anneal(share)
                self.density.update(self.done, share, drawing, pictures.views[camera], pictures, averaged)
                if averaged:
                    average.add(self.done, self.points.params.values())
                if self.done % SHOW_EVERY == 0 or self.done == end:
                    self.check()
                    progress.update(self.done, loss=float(loss), points=len(self.points))
            except GaussiansError as error:
                self.done = self.recovery.go_back(self.done, error, progress)
                self._anneal(self.done / total)
                self.density.restart(pictures)
                average = Average(self.config.average_share, total)
        self.recovery.drop()
        average.settle(self.points.params.values())
        self.density.prune(pictures.unit, self.done / total)

    def snapshot(self) -> Restore:
        """All that training changes, copied."""
        return together([self.points.snapshot(), self.gains.snapshot()])

    def check(self) -> None:
        """Raises `GaussiansError` if a value is NaN or infinite."""
        self.points.check()
        splat.check_finite(gains=self.gains.values)

    def step(
        self, pictures: Pictures, camera: int, static: StaticCache | None, share: float
    ) -> tuple[Tensor, Comparable]:
        """One iteration: draw what a camera sees, compare, follow the gradients. share: of training that is over.

        Returns the photometric loss [] and the drawing, which keeps its gradients.
        """
        view = pictures.views[camera]
        splats = deformed(self.points.params, None, None, view, pictures.near)
        if static is None or self._compares_all(pictures):
            gain = self.gains.of(camera)
            drawing = draw(splats, view, static.view(camera) if static else None)
            target = pictures.target(camera, drawing.image, gain)
        else:
            gain = self.gains.values[camera]
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
        """Mean dB over the pictures, without static points."""
        values = []
        for view, image, gain in zip(pictures.views, pictures.images[0], self.gains.values, strict=True):
            shown = draw(deformed(self.points.params, None, None, view, pictures.near), view).image
            values.append(psnr(shown * gain, image))
        return float(np.mean(values))

    def _static_cache(self, pictures: Pictures) -> StaticCache | None:
        if self.static is None or len(self.static) == 0:
            return None
        return StaticCache(self.static, pictures.views, pictures.near, self.points.means.device)

    def _compares_all(self, pictures: Pictures) -> bool:
        """Also where no point is that is trained."""
        shows = (self.done + 1) % SHOW_EVERY == 0
        return shows or self.done % GAINS_EVERY == 0 or pictures.unknown is not None

    def _anneal(self, share: float) -> None:
        late, pace = 0.3 if share > 0.8 else 1.0, self.recovery.pace
        factors = {"means": 0.02**share, "quats": 1.0, "log_scales": 0.2 if share > 0.8 else 1.0}
        self.points.scale_rates({name: pace * factor for name, factor in factors.items()}, default=pace * late)
