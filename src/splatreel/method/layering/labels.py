"""Motion layering at a keyframe (paper section 4.1): separation of static, dynamic and relit points.

`DYNAMIC_LABEL` divides static from dynamic points. Points whose light changes, such as in a shadow, are found beyond the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.config import LayeringConfig
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.images.change import changed_pixels
from splatreel.method.images.flow import make_flow
from splatreel.method.layering.lift import gather_images, lift, shares
from splatreel.method.layering.masks import make_segmenter, motion_masks
from splatreel.scene.camera import Camera, inside, project
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import C0, Gaussians, StaticPoints

DYNAMIC_LABEL = 0.5
"""Labels above this value are dynamic: the middle of 0 (static) and 1. A lower value makes more points dynamic, which costs
bytes."""


@dataclass(frozen=True)
class RelitPoints:
    """Points without motion, and the change of their light.

    Attributes:
        points: M points at the keyframe.
        light: [T, M] logarithm of each point's brightness at every frame, relative to the keyframe.
    """

    points: Gaussians
    light: np.ndarray

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    @property
    def shades(self) -> np.ndarray:
        """Change of c_base at every frame, [T, M, 3] float32."""
        return self._shade(self.light)

    @property
    def tracks(self) -> np.ndarray:
        """Positions at every frame, [T, M, 3] float32."""
        return np.repeat(self.points.means[None], len(self.light), 0)

    def at(self, frame: int) -> Gaussians:
        """Return the points with the colors they have at a frame."""
        return self.points.shaded(np.pad(self._shade(self.light[frame]), ((0, 0), (0, 1))))

    def _shade(self, light: np.ndarray) -> np.ndarray:
        """Return the change of c_base, [..., M, 3] float32, for a change of light [..., M]."""
        color = np.maximum(self.points.base_colors, 0)
        return (np.expm1(light)[..., None] * (color / C0)).astype(np.float32)


@dataclass(frozen=True)
class Layers:
    """Result of motion layering.

    Attributes:
        alive: [S] bool, static points that stay static.
        new_static: Dynamic points that become static.
        relit: Points without motion whose light changes. They belong to the group, but are not tracked.
    """

    alive: np.ndarray
    new_static: Gaussians
    dynamic: Gaussians
    relit: RelitPoints


def find_layers(data: GroupInput, dynamic: Gaussians, static: StaticPoints, config: LayeringConfig) -> Layers:
    """Separate the points at a keyframe into static, dynamic and relit ones."""
    data, points = data.smaller(), Gaussians.concatenate([dynamic, static.living])
    moves = label_points(data, points, config)
    if data.span.index:
        moves[: len(dynamic)] |= near_cameras(dynamic.means, data.cameras, data.layout.clearance)
    light = np.zeros((data.span.count, len(points)), np.float32)
    if config.relighting:
        light[:, ~moves] = changes_of_light(points[~moves], data.cameras, data.images, data.near)
    return separate(static, dynamic, moves, light)


def label_points(data: GroupInput, points: Gaussians, config: LayeringConfig) -> np.ndarray:
    """Return [N] bool, the points that move during a group."""
    if not config.enabled:
        return np.ones(len(points), bool)
    if data.span.count < 2 or len(points) == 0:
        return np.zeros(len(points), bool)
    masks = motion_masks(data.images, make_flow(config.flow), config)
    segmenter = make_segmenter(config.segment)
    if segmenter is not None:
        masks = segmenter.complete(masks, data.images[0])
    if not masks.any():
        return np.zeros(len(points), bool)
    labels = lift(points, data.cameras, masks, data.near, config)
    return labels > DYNAMIC_LABEL


def near_cameras(points: np.ndarray, cameras: list[Camera], clearance: Clearance) -> np.ndarray:
    """Return [N] bool, the points that a camera sees but that clearance would hide from it if they were static.

    Points this close to a camera stay dynamic, so that they are drawn.
    """
    found = np.zeros(len(points), bool)
    for camera in cameras:
        found |= clearance.hides(points, camera) & inside(camera, project(camera, points)[0])
    return found


def convertible(data: GroupInput, static: StaticPoints, least: float) -> np.ndarray:
    """Return [S] bool, the static points that adaptive conversion may make dynamic.

    A point that no camera sees may be converted, since it can be hidden at the keyframe. `least` is the minimum share
    of its contribution in pixels that change; 0 allows all points.
    """
    if not least:
        return static.alive
    data = data.smaller()
    found = shares(static.living, data.cameras, changed_pixels(data.images), data.near)
    return static.without(found < least).alive  # unseen points are NaN, which compares false


def separate(static: StaticPoints, dynamic: Gaussians, moves: np.ndarray, light: np.ndarray) -> Layers:
    """Sort dynamic and living static points by `moves` [D + A] bool and their change of light [T, D + A], 0 for none."""
    points = Gaussians.concatenate([dynamic, static.living])
    relit = ~moves & light.any(0)
    unmoved = ~moves & ~relit
    new_static, stays = unmoved[: len(dynamic)], unmoved[len(dynamic) :]
    return Layers(
        static.without(~stays).alive, dynamic[new_static], points[moves], RelitPoints(points[relit], light[:, relit])
    )


MIN_CHANGE = 0.08
"""Minimum change of light, as a logarithm of brightness."""
MIN_FRAMES = 2
"""Minimum number of frames with a change. Noise is gone in the next frame."""
MIN_VIEWS = 3
"""Minimum number of cameras that must see a point."""
MIN_AGREEING_SHARE = 0.6
"""Share of these cameras that must be within `ABSOLUTE_TOLERANCE` of the median, or within `RELATIVE_TOLERANCE` times the median."""
ABSOLUTE_TOLERANCE, RELATIVE_TOLERANCE = 0.04, 0.35
MAX_PIXELS = 1e5
"""Larger images are shrunk to this size. Shadows are larger than a pixel, and 36 images of a 4K camera would fill the memory."""
BLUR = 0.8
"""Standard deviation of the blur, pixels, against noise and misaligned edges."""
MIN_SEEN_PIXELS = 0.3
"""Minimum number of pixels of such an image that a point must fill to be seen."""
BLOCK = 4096
"""Points whose views are compared at a time."""
DARK_OFFSET = 8.0
"""Gray levels added to all brightness, so that noise of dark pixels is not a change of light."""
MAX_CHANGED_SHARE = 0.2
"""Maximum share of points that change light; if there are more, the strongest changes count."""


def changes_of_light(points: Gaussians, cameras: list[Camera], frames: np.ndarray, near: float) -> np.ndarray:
    """Return the logarithm [T, N] float32 of the brightness of static points, relative to the keyframe; 0 for no change.

    Flow sees a shadow move, or nothing at all; in truth the content changes color and stays in place. All views that see a point
    see it darken by the same factor. Of a body that passes in front of it, each view shows another part. Points are 0 in all frames
    if the views disagree, or if they change like most of an image.
    """
    found = np.zeros((len(frames), len(points)), np.float32)
    if len(frames) <= MIN_FRAMES or len(points) == 0:
        return found
    shown = _brightness_of(points, cameras, frames, near)
    changed = (np.abs(shown) > MIN_CHANGE).sum(2) >= MIN_FRAMES  # unseen points are NaN, which compares false
    index = np.flatnonzero(changed.sum(0) >= MIN_VIEWS)
    parts = [index[start : start + BLOCK] for start in range(0, len(index), BLOCK)]
    common = threads.map_parallel(lambda part: _common_changes(shown[:, part]), parts)
    light = np.concatenate([found[:, :0], *common], 1)
    strength = np.where((np.abs(light) > MIN_CHANGE).sum(0) >= MIN_FRAMES, np.abs(light).sum(0), 0)
    room = min(int(MAX_CHANGED_SHARE * len(points)), np.count_nonzero(strength))
    strongest = np.argsort(-strength, kind="stable")[:room]
    found[:, index[strongest]] = light[:, strongest]
    return found


def _brightness_of(points: Gaussians, cameras: list[Camera], frames: np.ndarray, near: float) -> np.ndarray:
    """Return the log brightness [C, N, T] of each point in each view, relative to the keyframe; NaN where not seen."""
    shown = np.full((len(cameras), len(points), len(frames)), np.nan, np.float32)

    def fill(view: int) -> None:
        row, small = shown[view], _shrunk(cameras[view])
        bright = partial(_brightness, width=small.width, height=small.height)
        images = np.stack(threads.map_parallel(bright, frames[:, view]), 2)
        images -= images[..., :1].copy()
        images -= np.median(images[::3, ::3], (0, 1))  # remove exposure and light of the whole scene
        images = np.concatenate([images, np.ones_like(images[..., :1])], 2)
        sums = gather_images(points, small, images, near)
        seen = sums[:, -1] > MIN_SEEN_PIXELS
        row[seen] = sums[seen, :-1] / sums[seen, -1:]

    threads.map_parallel(fill, range(len(cameras)))
    return shown


def _shrunk(camera: Camera) -> Camera:
    """Return the camera with an image of at most `MAX_PIXELS`."""
    shrink = min(1.0, (MAX_PIXELS / (camera.width * camera.height)) ** 0.5)
    return camera.resized(max(1, round(shrink * camera.width)), max(1, round(shrink * camera.height)))


def _brightness(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the log brightness [h, w] of an image [H, W, 3] uint8 at another size."""
    gray = cv2.cvtColor(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
    return np.log(cv2.GaussianBlur(gray.astype(np.float32), (0, 0), BLUR) + DARK_OFFSET)


def _common_changes(shown: np.ndarray) -> np.ndarray:
    """Return the changes [T, N] on which most of the views [C, N, T] agree; 0 in frames without agreement.

    Views that do not see a point are NaN in all frames. Every point is seen by a view.
    """
    count = (~np.isnan(shown[:, :, :1])).sum(0, keepdims=True)
    ordered = np.sort(shown, 0)  # NaN comes last
    low, high = (np.take_along_axis(ordered, place, 0)[0] for place in ((count - 1) // 2, count // 2))
    middle = (low + high) / 2
    alike = np.abs(shown - middle) < np.maximum(ABSOLUTE_TOLERANCE, RELATIVE_TOLERANCE * np.abs(middle))
    return np.where(alike.sum(0) / count[0] >= MIN_AGREEING_SHARE, middle, 0).T
