"""Fit of one set of moving points to a sequence whose frames were trained independently, by images of the frames."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from splatreel.capture.base import Capture
from splatreel.codec.header import ReelHeader
from splatreel.config import COARSENESS, Config, Quality, Rate, preset
from splatreel.config.settings import changed
from splatreel.errors import GaussiansError
from splatreel.play.renderers import draw_on_cpu
from splatreel.progress import Progress
from splatreel.recon.encode.group_writer import PresentationHook, no_presentation
from splatreel.recon.pipeline import reconstruct
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0
from splatreel.sequence.comparison import BLACK, Comparison, compare
from splatreel.sequence.edits import first_points
from splatreel.sequence.frames import Frames
from splatreel.sequence.viewpoints import SHOWS

SIDE = 768
"""Maximum pixels along the longer side of the images."""
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

    Args:
        film: The sequence.
        cameras: Cameras that see it.
        header: Frame rate, near plane and antialiasing that the sequence is drawn with.
    """

    def __init__(self, film: Frames, cameras: list[Camera], header: ReelHeader) -> None:
        self._film, self._near, self._antialias = film, header.near, header.antialias
        points = first_points(film)
        seen = points[points.opacities >= SHOWS]
        super().__init__(
            film.path,
            [camera.at_most(SIDE) for camera in cameras],
            held_out=[],
            frame_range=(0, len(film)),
            fps=header.fps,
            points=seen.means,
            point_colors=np.clip(seen.sh[:, 0] * C0 + 0.5, 0, 1),
        )
        self._digest = hashlib.sha256(points.means.tobytes() + str(film.size).encode()).hexdigest()

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        views = [self.camera(name) for name in cameras]
        for frame, images in enumerate(out, first):
            points = self._film.read(frame)
            for image, view in zip(images, views, strict=True):
                drawn = draw_on_cpu(points, view, self._near, self._antialias, BLACK)
                image[:] = np.rint(np.clip(drawn, 0, 1) * 255)

    def fingerprint(self) -> str:
        """Return a short string that changes with the cameras, the points of the first frame or the sequence's size."""
        return hashlib.sha256((super().fingerprint() + self._digest).encode()).hexdigest()[:16]


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
