"""Fit of one set of moving points to a sequence whose frames were trained independently, by images of the frames."""

from __future__ import annotations

import hashlib
from pathlib import Path
from threading import Lock

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.progress import Progress
from splatreel.capture.base import Capture
from splatreel.codec.header import ReelHeader
from splatreel.config import COARSENESS, Config, Quality, Rate, preset
from splatreel.config.settings import changed
from splatreel.importing.comparison import BLACK, Comparison, compare
from splatreel.importing.edits import first_points
from splatreel.importing.frames import Frames
from splatreel.importing.viewpoints import SHOWS
from splatreel.method.images.change import difference, per_camera
from splatreel.method.images.temporal_mean import MAX_DIFFERENCE, mean_of_alike
from splatreel.play.timeline import draw_on_cpu
from splatreel.run.output.group_writer import PresentationHook, no_presentation
from splatreel.run.pipeline import reconstruct
from splatreel.scene.camera import Camera
from splatreel.scene.reel_source import ReelSource

SIDE = 768
"""Maximum pixels along the longer side of the images."""
REACH = 3
"""Frames before and after an image that it is averaged with where they look alike."""
NOISE_MULTIPLE = 4.0
"""Difference above which images do not look alike, in multiples of the first quartile of the differences."""
EXACT_IMAGES = {
    "check_poses": False,
    "check_coverage": False,
    "correct_colors": False,
    "even_exposure": False,
    "background": False,
    "group.time_offsets": False,
}
"""Settings that correct real cameras are off: drawn images are exact, and black where there are no points."""


class FilmCapture(Capture):
    """Capture whose images are drawn from a sequence of Gaussians when they are read.

    Frames that were trained independently flicker where nothing moves. There, an image is averaged with its neighbors in
    time, or the flicker would be taken for motion.

    Args:
        film: The sequence.
        cameras: Cameras that see it.
        header: Frame rate, near plane and antialiasing that the sequence is drawn with.
    """

    def __init__(self, film: Frames, cameras: list[Camera], header: ReelHeader) -> None:
        self._film = film
        self._near = header.near
        self._antialias = header.antialias
        points = first_points(film)
        seen = points[points.opacities >= SHOWS]
        super().__init__(
            film.path,
            [camera.at_most(SIDE) for camera in cameras],
            held_out=[],
            frame_range=(0, len(film)),
            fps=header.fps,
            points=seen.means,
            point_colors=np.clip(seen.base_colors, 0, 1),
        )
        self._columns = {camera.name: column for column, camera in enumerate(self.cameras)}
        self._drawn: dict[int, np.ndarray] = {}
        self._lock = Lock()
        self._digest = hashlib.sha256(points.means.tobytes() + str(film.size).encode()).hexdigest()

    def reel_source(self) -> ReelSource:
        """Return a source without a frame: which frames of a capture the sequence shows is not known."""
        return ReelSource(None)

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        columns = [self._columns[name] for name in cameras]
        for frame, images in enumerate(out, first):
            window = [frame, *(other for other in self._window(frame) if other != frame)]
            drawn = np.stack([self._images(other)[columns] for other in window])
            images[:] = per_camera(steadied, drawn)

    def _window(self, frame: int) -> range:
        return range(max(frame - REACH, 0), min(frame + REACH + 1, len(self._film)))

    def _images(self, frame: int) -> np.ndarray:
        with self._lock:
            if frame not in self._drawn:
                while len(self._drawn) > 2 * REACH:
                    self._drawn.pop(max(self._drawn, key=lambda other: abs(other - frame)))
                points = self._film.read(frame)
                drawn = [draw_on_cpu(points, view, self._near, self._antialias, BLACK) for view in self.cameras]
                self._drawn[frame] = np.rint(255 * np.clip(np.stack(drawn), 0, 1)).astype(np.uint8)
            return self._drawn[frame]

    def fingerprint(self) -> str:
        """Return a short string that changes with the cameras, the points of the first frame or the sequence's size."""
        return hashlib.sha256((super().fingerprint() + self._digest).encode()).hexdigest()[:16]


def steadied(images: np.ndarray) -> np.ndarray:
    """Return the first image [H, W, 3] of one camera, averaged over images [T, H, W, 3] where they differ by flicker only."""
    first = images[0].astype(np.float32)
    flicker = [float(np.quantile(difference(image, first), 0.25)) for image in images[1:3]]
    return mean_of_alike(images, max(MAX_DIFFERENCE, NOISE_MULTIPLE * max(flicker, default=0.0)))


def fit_config(quality: Quality, rate: Rate) -> Config:
    """Return the settings of a fit."""
    return changed(preset(quality), EXACT_IMAGES | {"encode.coarseness": COARSENESS[rate]})


def fit_reel(
    film: Frames,
    cameras: list[Camera],
    header: ReelHeader,
    out: Path,
    config: Config,
    progress: Progress,
    present: PresentationHook = no_presentation,
) -> tuple[Path, Comparison]:
    """Fit moving points to a sequence, write them to OUT/reel, and compare the reel with the sequence.

    After an interruption, the same call continues. Checkpoints are in OUT/work.

    Args:
        film: The sequence.
        cameras: Cameras whose images are fitted.
        header: Frame rate, near plane and antialiasing that the sequence is drawn with.
        out: Output folder OUT.
        config: Settings, see `fit_config`.
        progress: Progress display.
        present: Function that adds further presentation.

    Raises:
        GaussiansError: The sequence is far from its origin, or its images are empty.
    """
    if header.origin.any():
        place = ", ".join(f"{value:.10g}" for value in header.origin)
        raise GaussiansError(
            f"{film.path}: lies near {place}, where points cannot be fitted. Move the points to the origin, or import without --fit."
        )
    capture = FilmCapture(film, cameras, header)
    result = reconstruct(capture, out, config, sound="none", progress=progress, present=present)
    return result.reel, compare(film, result.reel, progress, header.antialias)
