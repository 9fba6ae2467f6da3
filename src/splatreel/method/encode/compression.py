"""Compression of new static points and of finished groups (paper section 4.3). Nothing is written here.

The encoder distributes bits by the importance of points: how much the images depend on each.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from splatreel.base import threads
from splatreel.codec.encoder import EncodedLayer, ReelEncoder
from splatreel.codec.group_file import decode_parts
from splatreel.codec.header import ReelHeader
from splatreel.codec.predictive.precision import Steps
from splatreel.config import EncodeConfig
from splatreel.kernels import harmonics, project, rasterize, splat
from splatreel.method.cameras.group_input import ENOUGH_SIDE, GroupInput
from splatreel.method.encode.step_choice import encode_group_by_slope, encode_layer_by_slope
from splatreel.method.prediction.trial import Trial
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group, GroupSpan

VIEWS = 24
"""Maximum number of views drawn per moment."""
GROUP_MOMENTS, GROUP_VIEWS = 32, 2
"""Moments of a group at which importance is measured, and views drawn at each. Points that show only for a few frames count
too."""

Importance = tuple[np.ndarray | None, np.ndarray | None]
"""Importance of a group's dynamic points [N, 3], and of all static points so far [S, 3]; None where the codec does not use it."""


def group_importance(reel: ReelHeader, config: EncodeConfig, static: Gaussians, group: Group) -> Importance:
    """Measure the importance of a group's points over its frames.

    `static` are all points that `group.alive` refers to; those that are not alive have importance 0.
    """
    if config.codec == "h265" and not (config.h265.weighted_codebook and config.sh_entries):
        return None, None
    times = np.linspace(0, group.frames - 1, min(GROUP_MOMENTS, group.frames))
    moments = (Gaussians.concatenate([group.at(time), static[group.alive]]) for time in times)
    found = weigh(moments, list(reel.cameras), reel.near, reel.antialias, GROUP_VIEWS)
    of_static = np.zeros((len(static), 3), np.float32)
    of_static[group.alive] = found[len(group.dynamic) :]
    return found[: len(group.dynamic)], of_static


def weigh(
    moments: Iterable[Gaussians],
    cameras: list[Camera],
    near: float,
    antialias: bool = False,
    views: int = VIEWS,
) -> np.ndarray:
    """Return the importance [N, 3] float32 of points: of their shape (log scales), color and position (world units).

    Importance is the root of the summed squared derivatives of all pixels. Hutchinson's estimator gives it: the
    gradient of an image weighted by random signs has that sum as its expected square. Large images are drawn smaller
    and weighted by their size. `moments` are the same points at several times; at most `views` cameras are drawn at
    each.
    """
    squares: np.ndarray | float = 0.0
    samples = _samples(moments, cameras, views)
    while batch := list(islice(samples, threads.count())):  # the signs of no more images are in memory
        for found in threads.map_parallel(lambda sample: _squares(*sample, near, antialias), batch):
            squares = squares + found
    return np.sqrt(squares).astype(np.float32)


def _samples(
    moments: Iterable[Gaussians], cameras: list[Camera], views: int
) -> Iterator[tuple[Gaussians, Camera, float, np.ndarray]]:
    """Yield points, a camera to draw them, the pixels of an image as a multiple of the drawn ones, and a random sign for each value.

    The signs come from one generator, in order, whichever thread uses them.
    """
    rng = np.random.default_rng(0)
    smaller = [camera.at_most(ENOUGH_SIDE) for camera in cameras]
    apart = max(len(cameras) // views, 1)
    for number, points in enumerate(moments):
        # Every moment uses other cameras, spread over all of them.
        for camera, drawn in list(zip(cameras, smaller, strict=True))[number % apart :: apart][:views]:
            signs = rng.choice(np.array([-1, 1], np.float32), (drawn.height, drawn.width, 3))
            yield points, drawn, camera.width * camera.height / (drawn.width * drawn.height), signs


def _squares(
    points: Gaussians, camera: Camera, pixels: float, signs: np.ndarray, near: float, antialias: bool
) -> np.ndarray:
    """Return one sample of the squared derivatives, [N, 3], times a number of pixels. signs: [H, W, 3]."""
    blur = project.FINE_BLUR if antialias else project.BLUR
    view = project.Pinhole(camera.viewmat, camera.K, camera.width, camera.height, near, blur)
    shape = points.means, points.quats, points.scales
    projected = splat.project(*shape, view.viewmat, view.K, view.width, view.height, near, antialias)
    directions = points.means - camera.center
    colors = harmonics.forward(points.sh_degree, directions, points.sh) + np.float32(0.5)
    opacities = splat.antialiased(points.opacities, projected.conics) if antialias else points.opacities
    splats = projected.colored(np.maximum(colors, 0), opacities)
    bins = splat.bin(splats, view.width, view.height)
    image, alpha = rasterize.forward(bins, splats.colors)
    found = rasterize.backward(bins, splats.colors, image, signs, alpha, rasterize.no_gradient(alpha.shape))
    d_conics = found.conics
    if antialias:
        d_conics = d_conics + _antialias_gradient(points.opacities, projected.conics, found.opacities)
    none = rasterize.no_gradient((len(points),))
    d_means, _, d_scales = project.backward(
        *shape, projected.conics, found.means2d, d_conics, none, projected.radii, view
    )
    d_colors = np.where(colors >= 0, found.colors, np.float32(0))
    d_directions, d_sh = harmonics.backward(points.sh_degree, directions, points.sh, d_colors, to_directions=True)
    if d_directions is not None:
        d_means += d_directions
    parts = d_scales * points.scales, d_sh[:, 0], d_means
    return pixels * np.stack([np.square(slopes).sum(1) for slopes in parts], 1)


def _antialias_gradient(opacities: np.ndarray, conics: np.ndarray, d_opacities: np.ndarray) -> np.ndarray:
    """Return the gradient [N, 3] to conics through `splat.antialiased`, from the gradient [N] to its result."""
    xx, xy, yy = conics.T
    kept = project.kept_area(xx, xy, yy)
    d_kept = np.where(kept >= 1e-6, 0.5 * d_opacities * opacities / np.sqrt(np.maximum(kept, 1e-6)), np.float32(0))
    blur = project.FINE_BLUR
    return d_kept[:, None] * np.stack([blur**2 * yy - blur, -2 * blur**2 * xy, blur**2 * xx - blur], 1)


@dataclass(frozen=True)
class Coding:
    """Encoder of a reel, and the properties of the run that decide how many bits points get.

    Attributes:
        header: Header of the reel, whose cameras measure the importance of points.
        trial: Result of the trial that left a camera out; None if there was no trial.
    """

    encoder: ReelEncoder
    header: ReelHeader
    trial: Trial | None


@dataclass(frozen=True)
class CompressedLayer:
    """The static points that a group adds, in the order of the reel.

    Attributes:
        trained: Points [N] as trained.
        decoded: The same points as the reel holds them.
        importance: [N, 3], see `ReelEncoder.layer`.
        steps: Quantization steps at a coarseness of 1.
        files: Files of the layer's parts.
    """

    group: int
    first_frame: int
    trained: Gaussians
    decoded: Gaussians
    importance: np.ndarray
    steps: Steps
    files: tuple[bytes, ...]

    @staticmethod
    def of(
        span: GroupSpan, points: Gaussians, importance: np.ndarray, steps: Steps, encoded: EncodedLayer
    ) -> CompressedLayer:
        """Return the layer of points [N] in the order of training. `encoded`: the result of `ReelEncoder.layer` for them."""
        files, order = encoded
        decoded = decode_parts(files, f"The layer of group {span.index}")
        return CompressedLayer(span.index, span.first, points[order], decoded, importance[order], steps, files)

    @property
    def encoded(self) -> EncodedLayer:
        """The files, and the order of the points among `trained`."""
        return self.files, np.arange(len(self.trained))


@dataclass(frozen=True)
class CompressedGroup:
    """A finished group.

    Attributes:
        importance: [N, 3] of its dynamic points; None where the codec does not use it.
        steps: Quantization steps at a coarseness of 1.
        files: Files by URI, the best rendition first.
    """

    group: Group
    importance: np.ndarray | None
    steps: Steps
    files: dict[str, bytes]


def compress_layer(
    data: GroupInput, points: Gaussians, moving: Gaussians, static: Gaussians, coding: Coding
) -> CompressedLayer:
    """Encode new static points as a layer, and decode them again. `moving`: dynamic and relit points at the keyframe."""
    count = len(points)
    seen = Gaussians.concatenate([points, moving, static])
    importance = weigh([seen], data.cameras, data.near, data.antialias)[:count]
    others, moved = seen[count:], len(moving)
    encoded, steps = encode_layer_by_slope(coding.encoder, data, points, others, moved, importance, coding.trial)
    return CompressedLayer.of(data.span, points, importance, steps, encoded)


def compress_group(data: GroupInput, group: Group, static: StaticPoints, coding: Coding) -> CompressedGroup:
    """Encode a finished group, with quantization steps chosen by its images."""
    encoder = coding.encoder
    importance = group_importance(coding.header, encoder.config, static.points, group)[0]
    files, steps = encode_group_by_slope(encoder, data, group, static, importance, coding.trial)
    return CompressedGroup(group, importance, steps, files)
