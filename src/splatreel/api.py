"""Functions of the Python API that accept paths where the modules below take open objects, and show progress."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from splatreel.base.command_line import needing_packages
from splatreel.base.display import console
from splatreel.base.progress import Cancellable, Progress, Silent
from splatreel.capture.base import Capture
from splatreel.capture.opening import open_capture
from splatreel.codec.reader import find_reel
from splatreel.config import Config, Quality, preset
from splatreel.config.presets import unusual_settings
from splatreel.config.settings import without_effect
from splatreel.kernels.image import render_image
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

if TYPE_CHECKING:
    from splatreel.evaluation.report import Report
    from splatreel.run.output.group_writer import PresentationHook
    from splatreel.run.pipeline import Result


def reconstruct(
    capture: Capture | str | Path,
    out: str | Path,
    config: Config | Quality = "standard",
    *,
    sound: str = "auto",
    device: str = "auto",
    progress: Progress | bool = False,
    cancel: threading.Event | None = None,
    present: PresentationHook | None = None,
) -> Result:
    """Reconstruct a capture into OUT/reel, with checkpoints in OUT/work. The same call continues an interrupted run.

    Finished parts stay, whatever is raised.

    Args:
        capture: The capture, opened at the size to train on; or its path, to train on all frames at full size.
        out: Output folder OUT.
        config: Settings, or the name of a preset: draft, standard or paper.
        sound: auto (the best soundtrack of the cameras), none, the name of a camera, or a file.
        device: auto, cpu, gpu or cuda.
        progress: Display of the progress. True shows a bar in a terminal or a notebook, and lines elsewhere.
        cancel: Event that stops the reconstruction when another thread sets it.
        present: Adds poster and thumbnails to the reel.

    Raises:
        CancelledError: `cancel` was set.
        ReconstructionError: OUT belongs to another capture or configuration, OUT is in use, or a checkpoint is damaged.
        UsageError: The device or the preset does not exist.
        MissingDependencyError: OpenCV, or a package or weights that the settings need, are missing.
        StorageError: The disk is full or cannot be written.
        CaptureError: The capture cannot be read.
    """
    with needing_packages():
        from splatreel.run import pipeline
        from splatreel.run.output.group_writer import no_presentation

        settings = preset(config) if isinstance(config, str) else config
        with _opened(capture) as source, _shown(progress, cancel) as display:
            for name, text in without_effect(settings, unusual_settings(settings)).items():
                display.note(f"{name} {text}")
            return pipeline.reconstruct(
                *(source, Path(out), settings),
                sound=sound,
                device=device,
                progress=display,
                present=no_presentation if present is None else present,
            )


def evaluate(
    reel: str | Path,
    capture: Capture | str | Path,
    *,
    out: str | Path | None = None,
    cameras: Sequence[str] | None = None,
    frames: Sequence[int] | None = None,
    rendition: str | None = None,
    lpips_every: int = 10,
    progress: Progress | bool = False,
    cancel: threading.Event | None = None,
) -> Report:
    """Render a reel from held-out cameras of its capture and measure its quality.

    Args:
        reel: Folder or URL of the reel, or the output folder OUT of `reconstruct`.
        capture: The path of the capture that the reel was made from, which is opened with the frames and cameras of the reel; or the
            capture itself, opened with the same frames.
        out: Folder for report.json, report.md, report.html and images.
        cameras: Names of the cameras to compare with; None means the held-out ones.
        frames: Frames to compare; None means all that the reel and the capture share.
        rendition: Name of a rendition; None chooses the best.
        lpips_every: Distance of the frames that LPIPS is measured at; 1 measures every frame, 0 none.
        progress: Display of the progress. True shows a bar in a terminal or a notebook, and lines elsewhere.
        cancel: Event that stops the evaluation when another thread sets it.

    Raises:
        CancelledError: `cancel` was set.
        UsageError: Cameras or frames do not match.
        MissingDependencyError: OpenCV is missing, or the weights of LPIPS are damaged.
        CaptureError: The capture cannot be read.
        ReelError: The reel cannot be read.
    """
    with needing_packages():
        from splatreel.evaluation import evaluate as evaluation
        from splatreel.evaluation.reel_capture import open_reel_capture

        folder = find_reel(reel)
        chosen = frames
        with ExitStack() as opened:
            if isinstance(capture, Capture):
                source = capture
            else:
                source, shown = open_reel_capture(folder, capture, names=cameras)
                opened.callback(source.close)
                chosen = shown if frames is None else frames
            display = opened.enter_context(_shown(progress, cancel))
            return evaluation.evaluate(
                *(folder, source),
                out=None if out is None else Path(out),
                cameras=cameras,
                frames=chosen,
                rendition=rendition,
                lpips_every=lpips_every,
                progress=display,
            )


def render(
    gaussians: Gaussians,
    camera: Camera,
    *,
    near: float | None = None,
    degree: int | None = None,
    background: tuple[float, float, float] = (0, 0, 0),
    antialias: bool = False,
) -> np.ndarray:
    """Render the view of a camera.

    The first call compiles the kernels if they are not in the cache yet. A line of the logger `splatreel` says so.

    Args:
        gaussians: The Gaussians.
        camera: The camera, whose size is the size of the image.
        near: Smallest depth drawn, world units. None: that of the Gaussians, or 0.01 if they have none.
        degree: SH degree used. None: the degree of the Gaussians.
        background: RGB, 0..1, shown where alpha is below 1.
        antialias: True for Gaussians that were trained antialiased; the manifest of a reel has the flag.

    Returns:
        The image [H, W, 3] float32, sRGB, 0..1.

    Raises:
        GaussiansError: A value is NaN or infinite, or the Gaussians do not have the SH degree.
    """
    near = gaussians.near if near is None else near
    near = 0.01 if near is None else near
    image = render_image(gaussians, camera, near=near, degree=degree, background=background, antialias=antialias)
    return np.clip(image, 0, 1)


@contextmanager
def _opened(capture: Capture | str | Path) -> Iterator[Capture]:
    """Yield a capture. One that is opened here is closed at the end."""
    if isinstance(capture, Capture):
        yield capture
        return
    source = open_capture(capture)
    try:
        yield source
    finally:
        source.close()


@contextmanager
def _shown(progress: Progress | bool, cancel: threading.Event | None) -> Iterator[Progress]:
    """Yield the display of the progress, which also watches for the cancellation."""
    own = console() if progress is True else None
    shown: Progress = own or (Silent() if isinstance(progress, bool) else progress)
    try:
        yield shown if cancel is None else Cancellable(shown, cancel)
    finally:
        if own is not None:
            own.close()
