"""Ground under a subject: the floor of the capture as static points, with the texture that most frames show.

A subject alone floats. The floor is a plane under the feet, which all cameras see in the same colors. The median of a few frames
shows it without people who move.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from splatreel.base.errors import UsageError
from splatreel.capture.opening import open_capture
from splatreel.capture.reading import median_images
from splatreel.edit.clip import ChangedClip, Clip, ClipGroup, ClipLayer, LayerSpan, shown_points
from splatreel.scene import rotations
from splatreel.scene.camera import Camera, inside, project
from splatreel.scene.gaussians import C0, Gaussians, turn_between
from splatreel.scene.volumes import CaptureVolume

FLAT = 0.8
"""Cosine between up and the thinnest axis above which a point is part of a horizontal surface."""
BINS = 200
"""Heights that are told apart, between the lowest and the highest horizontal surface."""
FEWEST = 20
"""Number of horizontal points below the cameras' focus that a floor has."""


def floor_height(clip: Clip) -> float:
    """Return the height along `up` of the largest horizontal surface below the focus, at the first frame.

    Points count by their area and opacity. At least two cameras have them in their images.

    Raises:
        UsageError: There is no horizontal surface.
    """
    header = clip.outline.header
    points, _, _ = shown_points(clip, 0, 0.0)
    cameras = header.cameras
    seen = CaptureVolume(cameras, header.near, 2 / max(len(cameras), 2)).contains(points.means)
    points = points[seen] if seen.any() else points
    thinnest = points.scales.argmin(1)
    normals = rotations.to_matrix(points.quats)[np.arange(len(points)), :, thinnest]
    heights = points.means @ header.up
    flat = (np.abs(normals @ header.up) > FLAT) & (heights < clip.outline.focus @ header.up)
    if flat.sum() < FEWEST:
        raise UsageError(
            f"floor: {clip.outline.name} shows no floor below the middle of the scene. Write move=X,Y,Z with the shift instead, or "
            "turn the scene upright first (rotate)."
        )
    areas = np.sort(points.scales[flat], axis=1)[:, 1:].prod(1) * points.opacities[flat]
    heights = heights[flat]
    low, high = np.quantile(heights, [0.001, 0.999])
    sums, edges = np.histogram(heights, BINS, (low, max(high, low + 1e-9)), weights=areas)
    smooth = np.convolve(sums, [0.5, 1, 0.5], "same")
    best = int(smooth.argmax())
    near = np.abs(heights - (edges[best] + edges[best + 1]) / 2) <= edges[1] - edges[0]
    return float(np.average(heights[near], weights=np.maximum(areas[near], 1e-30)))


MOMENTS = 15
"""Number of frames whose median is the clean plate of a camera."""
_FEET = 0.01
"""Share of the subject's points that may be below its feet: strays, and shadows in masks."""
MARGIN = 0.6
"""Width of the ground around the subject, in heights of the subject."""
_SOFT = 0.35
"""Share of this width at the edge, over which the ground fades."""
SEARCHED = 0.12
"""Height above and below the feet in which the plane is searched, in heights of the subject."""
_FARTHER = 0.1
"""Disagreement, 0..1, that counts as much as the whole searched height."""
PIXELS = 1.5
"""Distance of two points, pixels of a typical camera."""
AGREE = 0.12
"""Largest standard deviation of the colors, 0..1, that cameras show at a place of the floor."""
FEW_SHARED = 0.25
"""Share of the seen places that several cameras show, below which those that one camera shows count as known, too."""
SOFT_TEXTURE = 0.06
"""Standard deviation of the blur with which the texture fades into a plain floor, in heights of the subject."""
_TILTED = 0.7
"""Share of the disagreement in a level plane, below which a tilted one is taken."""
MOST = 30_000
"""Largest number of points; they are farther apart if there would be more."""


class Grounded(ChangedClip):
    """Clip with one more layer, which all groups show.

    `ground`: Points of the layer.
    """

    def __init__(self, clip: Clip, ground: Gaussians) -> None:
        outline = clip.outline
        super().__init__(clip, replace(outline, layers=(*outline.layers, LayerSpan(0))))
        self._place = len(outline.layers)
        self._ground = ground

    def layer_origin(self, index: int) -> tuple[Clip, int]:
        """Return the clip that a layer comes from, and its index there."""
        return (_Layer(self._clip, self._ground), 0) if index == self._place else (self._clip, index)

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group that shows the ground too."""
        return replace(found, alive={**found.alive, self._place: np.ones(len(self._ground), bool)})


class _Layer:
    """Clip with the outline of another one, whose only layer is given."""

    def __init__(self, clip: Clip, points: Gaussians) -> None:
        self.outline = clip.outline
        self._clip = clip
        self._points = points

    def layer(self, index: int) -> ClipLayer:
        return ClipLayer(self._points, None)

    def group(self, index: int, rendition: str | None = None) -> ClipGroup:
        return self._clip.group(index, rendition)


def with_ground(clip: Clip, path: str | Path) -> Clip:
    """Return a clip of a subject with the ground of its capture.

    `path`: Folder or address of the capture.

    Raises:
        CaptureError: The capture cannot be used.
        UsageError: It is not the capture of the clip, or its cameras do not see the ground, or the clip shows nothing.
    """
    header = clip.outline.header
    cameras = list(header.cameras)
    if not cameras:
        raise UsageError(f"ground: {clip.outline.name} has no cameras. Edit the reel that it was made from.")
    capture = open_capture(path, width=cameras[0].width, held_out=[])
    try:
        names = {camera.name for camera in capture.cameras}
        if missing := [camera.name for camera in cameras if camera.name not in names]:
            raise UsageError(
                f"ground: {path} has no camera {missing[0]!r}, which {clip.outline.name} was made from. Name that reel's capture."
            )
        if (capture.width, capture.height) != (cameras[0].width, cameras[0].height):
            raise UsageError(
                f"ground: images of {path} are {capture.width} x {capture.height} at the width of {clip.outline.name}, whose "
                f"cameras have {cameras[0].width} x {cameras[0].height} pixels. Name that reel's capture."
            )
        plates = np.stack(median_images(capture, [camera.name for camera in cameras], MOMENTS)).astype(np.float32) / 255
    finally:
        capture.close()
    plane = _Plane.under(clip, header.up)
    found = _best(plane, cameras, plates)
    ground = _gaussians(found, cameras, plates, header.near)
    if not len(ground):
        raise UsageError(f"ground: no camera of {path} sees the floor under the subject. Leave ground out.")
    return Grounded(clip, ground)


@dataclass(frozen=True)
class _Plane:
    """Horizontal piece of a plane.

    Attributes:
        center: [3] under the middle of the subject, at its feet.
        up: [3] unit.
        right: [3] unit, in the plane.
        size: [2] half of the width along `right`, and across it.
        height: Height of the subject, world units.
    """

    center: np.ndarray
    up: np.ndarray
    right: np.ndarray
    size: np.ndarray
    height: float

    @staticmethod
    def under(clip: Clip, up: np.ndarray) -> _Plane:
        """Return the plane at the feet of what a clip shows, as wide as its way."""
        groups = clip.outline.groups
        shown = [shown_points(clip, index, 0.0)[0] for index in range(len(groups))]
        shown.append(shown_points(clip, len(groups) - 1, float(groups[-1].frames - 1))[0])
        points = np.concatenate([some.means[some.opacities > 0.5] for some in shown]).astype(np.float64)
        if not len(points):
            raise UsageError(
                f"ground: {clip.outline.name} shows nothing that could stand on a floor. Leave ground out."
            )
        right = np.eye(3)[np.abs(up).argmin()]
        right = right - (right @ up) * up
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(up, right), up])
        low, high = np.quantile(points @ axes.T, [_FEET, 1 - _FEET], axis=0)
        height = float(high[2] - low[2])
        center = np.array([*(low + high)[:2] / 2, low[2]]) @ axes
        return _Plane(center, up, right, (high - low)[:2] / 2 + MARGIN * height, height)

    def raised(self, share: float) -> _Plane:
        """Return the plane moved up, in heights of the subject."""
        return replace(self, center=self.center + share * self.height * self.up)

    def tilted(self, along: float, across: float) -> _Plane:
        """Return the plane tilted by small angles, radians."""
        up = self.up + along * self.right + across * np.cross(self.up, self.right)
        up /= np.linalg.norm(up)
        right = self.right - (self.right @ up) * up
        return replace(self, up=up, right=right / np.linalg.norm(right))

    def grid(self, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Return places [A, B, 3] every `step` world units, and how far out each is [A, B], 1 at the border of the ground."""
        counts = np.maximum(np.ceil(self.size / step).astype(int), 1)
        a, b = (np.arange(-count, count + 1) * step for count in counts)
        x, y = np.meshgrid(a, b, indexing="ij")
        places = self.center + x[..., None] * self.right + y[..., None] * np.cross(self.up, self.right)
        return places, np.hypot(x / self.size[0], y / self.size[1])


def _colors(places: np.ndarray, cameras: list[Camera], plates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the colors [C, P, 3] of places in each camera, and which cameras show a place, [C, P]."""
    colors, seen = np.zeros((len(cameras), len(places), 3)), np.zeros((len(cameras), len(places)), bool)
    for number, (camera, plate) in enumerate(zip(cameras, plates, strict=True)):
        pixels, depth = project(camera, places)
        seen[number] = inside(camera, pixels) & (depth > 0)
        column, row = pixels[seen[number]].astype(np.int64).T
        colors[number, seen[number]] = plate[row, column]
    return colors, seen


def _best(plane: _Plane, cameras: list[Camera], plates: np.ndarray) -> _Plane:
    """Return the plane near the feet in which the cameras agree best. It is level unless they agree much better in a tilted one."""

    def disagreement(candidate: _Plane) -> float:
        places, out = candidate.grid(float(candidate.size.max()) / 40)
        colors, seen = _colors(places[out < 1], cameras, plates)
        several = seen.sum(0) > 1
        if not several.any():
            return np.inf
        away = abs((candidate.center - plane.center) @ plane.up) / (SEARCHED * plane.height)
        return float(np.median(_spread(colors, seen)[several]) + _FARTHER / 10 * away)

    level = plane
    # The plane so far is the first of them. It stays where no two cameras show it, so that all disagree as much.
    for fine in (1.0, 0.3):
        steps = fine * np.linspace(-1, 1, 13)
        level = min((level, *(level.raised(SEARCHED * step) for step in steps)), key=disagreement)
    best = level
    for fine in (1.0, 0.3):
        steps = fine * np.linspace(-1, 1, 13)
        best = min((best, *(best.tilted(np.radians(4) * step, 0) for step in steps)), key=disagreement)
        best = min((best, *(best.tilted(0, np.radians(4) * step) for step in steps)), key=disagreement)
        best = min((best, *(best.raised(0.3 * SEARCHED * step) for step in steps)), key=disagreement)
    return best if disagreement(best) < _TILTED * disagreement(level) else level


def _spread(colors: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return how much cameras differ at each place [P], 0..1, without their exposures; infinite where fewer than two show it."""
    several = seen.sum(0) > 1
    known = np.where(seen[..., None], colors, np.nan)[:, several]
    exposures = np.zeros((len(seen), 1, 1))
    for number, own in enumerate(known):
        exposures[number] = np.nanmedian(own) if seen[number, several].any() else 0
    found = np.full(seen.shape[1], np.inf)
    found[several] = np.nanstd(known - exposures, 0).mean(-1)
    return found


def _gaussians(plane: _Plane, cameras: list[Camera], plates: np.ndarray, near: float) -> Gaussians:
    """Return flat points with the median color of the cameras that show each place, fading at the border.

    Where fewer than two cameras show the floor, or others show something before it, the texture fades into a plain floor.
    """
    pixel = np.median([project(camera, plane.center)[1] / camera.K[0, 0] for camera in cameras])
    step = max(PIXELS * abs(float(pixel)), float(np.sqrt(np.pi * plane.size.prod() / MOST)), near * 1e-3)
    grid, out = plane.grid(step)
    colors, seen = _colors(grid.reshape(-1, 3), cameras, plates)
    if not seen.any():
        return Gaussians.empty(0)
    spread = _spread(colors, seen)
    known = np.less(spread, AGREE)
    if np.isfinite(spread).sum() < FEW_SHARED * seen.any(0).sum():
        known = known | (seen.sum(0) == 1)
    if not known.any():
        known = seen.any(0)
    color = np.zeros((known.size, 3))
    color[known] = np.nanmedian(np.where(seen[..., None], colors, np.nan)[:, known], 0)
    color = _filled(color.reshape(grid.shape), np.asarray(known).reshape(out.shape), SOFT_TEXTURE * plane.height / step)
    inside_border = out < 1
    places, out, color = grid[inside_border], out[inside_border], color[inside_border]
    count = len(places)
    fade = np.clip((1 - out) / _SOFT, 0, 1)
    scales = np.broadcast_to([0.6 * step, 0.6 * step, 0.05 * step], (count, 3))
    quats = np.broadcast_to(turn_between(np.array([0.0, 0.0, 1.0]), plane.up), (count, 4))
    opacities = 0.98 * fade**2 * (3 - 2 * fade)
    shown = opacities > 0.02
    points = Gaussians(places, quats, scales, opacities, ((color - 0.5) / C0)[:, None])
    return points[shown]


def _filled(color: np.ndarray, known: np.ndarray, sigma: float) -> np.ndarray:
    """Return colors [A, B, 3] that become blurred, then plain, where they are not known [A, B] bool. `sigma`: grid steps."""
    plain = np.median(color[known], 0)
    share = gaussian_filter(known.astype(float), sigma, mode="nearest")
    blurred = gaussian_filter(color * known[..., None], (sigma, sigma, 0), mode="nearest")
    blurred /= np.maximum(share, 1e-6)[..., None]
    sharp = (known * np.clip((share - 0.5) / 0.4, 0, 1))[..., None]
    there = np.clip(share / 0.5, 0, 1)[..., None]
    return sharp * color + (1 - sharp) * (there * blurred + (1 - there) * plain)
