"""Evaluation of a decoded reel against held-out cameras of its capture, or against training views."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from PIL import Image

from splatreel.capture.base import Capture
from splatreel.codec.info import ReelInfo, reel_info
from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.errors import UsageError
from splatreel.evaluation import perceptual
from splatreel.evaluation.flicker import Flicker, border_frames
from splatreel.evaluation.metrics import psnr, psnr_per_channel, ssim
from splatreel.evaluation.report import Quality, Report
from splatreel.play.timeline import Timeline
from splatreel.process import peak_memory_bytes
from splatreel.progress import Progress, Silent
from splatreel.scene.atomic import replacing, sweep
from splatreel.scene.camera import Camera, angles_apart
from splatreel.scene.gaussians import Gaussians

CHUNK = 8
"""Frames read from the capture at a time."""


def evaluate(
    reel: str | Path,
    capture: Capture,
    *,
    rendition: str | None = None,
    cameras: Sequence[str] | None = None,
    out: Path | None = None,
    undecoded: Callable[[int], Gaussians] | None = None,
    frames: Sequence[int] | None = None,
    seconds: Mapping[str, float] | None = None,
    device: str = "cpu",
    progress: Progress | None = None,
    most: int | None = None,
    coverage: Sequence[str] = (),
) -> Report:
    """Render the decoded reel from held-out cameras and measure its quality.

    Args:
        reel: Folder or URL of the reel.
        capture: Capture that the reel was made from.
        rendition: Name of a rendition; None chooses the best.
        cameras: Names of cameras; None uses the default of `choose_cameras`.
        out: Folder for report.json, report.md and an image per camera: truth, render and error of the middle frame.
        undecoded: Function from a frame to the Gaussians before encoding, for `psnr_undecoded`.
        frames: Frames to evaluate; None means all frames that the reel and the capture share.
        seconds: Wall time of earlier stages, for the report.
        device: Device of the reconstruction, for the report.
        progress: Progress display.
        most: Memory in bytes that decoding a file may take, see `ReelReader`.
        coverage: Sentences about the coverage of the cameras, for the report.

    Raises:
        UsageError: Cameras or frames do not match.
    """
    started = time.monotonic()
    progress = progress or Silent()
    reader = ReelReader(reel, rendition, most)
    check_same_capture(reader.manifest, capture, str(reel))
    views = choose_cameras(capture, reader.manifest, cameras)
    chosen = choose_frames(min(capture.frames, reader.frames), frames, reader.manifest.first_frame)
    picture = chosen[len(chosen) // 2]
    timeline, lpips = Timeline(reader), perceptual.load()
    if out is not None:
        for folder in (out, out / "pictures"):
            sweep(folder)
    scores: dict[tuple[int, str], Quality] = {}
    before: list[float] = []
    flicker = Flicker(border_frames(reader.manifest))
    progress.stage(f"comparing with {', '.join(view.name for view in views)}", len(chosen))
    for done, (frame, truths) in enumerate(read_frames(capture, chosen, [v.name for v in views]), 1):
        gaussians = timeline.at(frame / reader.fps)
        raw = undecoded(frame) if undecoded is not None else None
        for view, truth in zip(views, truths, strict=True):
            image = np.clip(timeline.render(gaussians, view), 0, 1)
            scores[frame, view.name] = measure(image, truth, lpips)
            flicker.add(frame, view.name, image, truth)
            if raw is not None:
                before.append(psnr(np.clip(timeline.render(raw, view), 0, 1), truth))
            if out is not None and frame == picture:
                write_png(out / "pictures" / f"{view.name.replace('/', '_')}.png", comparison(truth, image))
        progress.update(done, psnr=float(np.mean([q.psnr for q in scores.values()])))
    spent = {**(seconds or {}), "evaluate": round(time.monotonic() - started, 3)}
    report = summarize(reader, reel_info(reel, rendition), scores, before, flicker, views, spent, device)
    report = replace(report, coverage=list(coverage))
    if out is not None:
        report.write(out)
    return report


def measure(
    image: np.ndarray, truth: np.ndarray, lpips: perceptual.Distance | None, where: np.ndarray | None = None
) -> Quality:
    """Return all metrics of an image against its truth, both float32 [H, W, 3] 0..1.

    Args:
        image: Rendered image.
        truth: Camera image.
        lpips: LPIPS metric, or None.
        where: Pixels to measure, [H, W] bool; None means all. LPIPS needs the whole image and is skipped with a mask.
    """
    distance = lpips(image, truth) if lpips is not None and where is None else None
    pair = image, truth, where
    return Quality(psnr(*pair), psnr_per_channel(*pair), ssim(*pair), distance)


def summarize(
    reader: ReelReader,
    info: ReelInfo,
    scores: dict[tuple[int, str], Quality],
    before: list[float],
    flicker: Flicker,
    views: Sequence[Camera],
    seconds: dict[str, float],
    device: str,
) -> Report:
    """Return the report of scores by frame and camera name."""
    frames = sorted({frame for frame, _ in scores})
    names = list(dict.fromkeys(name for _, name in scores))
    trained_on = [camera.name for camera in reader.manifest.cameras]
    degrees = degrees_from(reader.manifest, views)
    alive = [int(reader.group(entry.group).alive.sum()) for entry in reader.manifest.groups]
    return Report(
        **asdict(Quality.mean(list(scores.values()))),
        psnr_undecoded=float(np.mean(before)) if before else None,
        flicker=flicker.mean(at_borders=False),
        flicker_borders=flicker.mean(at_borders=True),
        reel_bytes=info.bytes,
        first_view_bytes=info.first_view_bytes,
        bytes_per_second=info.bytes_per_second,
        seconds=seconds,
        points_static=float(np.mean(alive)),
        points_dynamic=float(np.mean([g.points for g in reader.manifest.groups])),
        peak_memory_bytes=peak_memory_bytes(),
        device=device,
        frames=len(frames),
        width=views[0].width,
        height=views[0].height,
        cameras=[
            {"name": n} | asdict(Quality.mean([scores[f, n] for f in frames])) | {"degrees": degrees[n]} for n in names
        ],
        trained_on=trained_on,
        held_out=[name for name in names if name not in trained_on],
        per_frame=[{"frame": f} | asdict(Quality.mean([scores[f, n] for n in names])) for f in frames],
    )


def degrees_from(manifest: Manifest, views: Sequence[Camera]) -> dict[str, float | None]:
    """Return the angle of each view to the nearest training camera, seen from the focus point, or None without a focus point."""
    limits, trained = manifest.presentation.limits, list(manifest.cameras)
    if limits is None or not trained:
        return {view.name: None for view in views}
    angles = [angles_apart([view, *trained], np.array(limits.focus))[0, 1:].min() for view in views]
    return {view.name: round(float(angle), 2) for view, angle in zip(views, angles, strict=True)}


def read_frames(capture: Capture, frames: list[int], names: list[str]):
    """Yield each frame in ascending order with its images, float32 [C, H, W, 3] 0..1. Consecutive frames are read together."""
    for first in range(0, len(frames), CHUNK):
        chunk = frames[first : first + CHUNK]
        consecutive = chunk[-1] - chunk[0] + 1 == len(chunk)
        images = capture.read(chunk[0], len(chunk), names) if consecutive else None
        for i, frame in enumerate(chunk):
            truths = images[i] if images is not None else capture.read(frame, 1, names)[0]
            yield frame, truths.astype(np.float32) / 255


def choose_cameras(capture: Capture, manifest: Manifest, names: Sequence[str] | None) -> list[Camera]:
    """Return the cameras to evaluate.

    Args:
        capture: Capture of the reel.
        manifest: Manifest of the reel.
        names: Names of cameras. None means the held-out cameras that the reel was not trained on, or all held-out
            cameras if the reel was trained on each of them.

    Raises:
        UsageError: There are no cameras, or a mix of held-out and training views, whose mean would be meaningless.
    """
    trained = {camera.name for camera in manifest.cameras}
    if names is None:
        names = [name for name in capture.held_out if name not in trained] or capture.held_out
    if not names:
        raise UsageError(f"{capture.path}: no camera is held out. Name the cameras to evaluate: --cameras NAME,NAME.")
    seen = [name for name in names if name in trained]
    if seen and len(seen) < len(names):
        raise UsageError(
            f"--cameras {','.join(names)}: the reel was trained on {', '.join(seen)} and not on the others. "
            "Evaluate one kind at a time."
        )
    return [capture.camera(name) for name in names]


def choose_frames(available: int, frames: Sequence[int] | None, first: int = 0) -> list[int]:
    """Return sorted frames, by default all from `first` to `available` - 1. Raise `UsageError` for a frame outside this range."""
    chosen = list(range(first, available)) if frames is None else sorted(set(frames))
    bad = [f for f in chosen if not first <= f < available]
    if bad or not chosen:
        raise UsageError(
            f"Frames {bad or 'none'} cannot be evaluated: reel and capture share frames {first} to {available - 1}."
        )
    return chosen


def check_same_capture(manifest: Manifest, capture: Capture, reel: str) -> None:
    """Raise `UsageError` if the reel was made with other cameras than the capture's.

    Up to a third of the cameras may have another pose, because training corrects poses (`recon/cameras/poses.py`).
    """
    known = {camera.name: camera for camera in capture.cameras}
    moved = [
        camera.name
        for camera in manifest.cameras
        if camera.name not in known or not np.allclose(known[camera.name].viewmat, camera.viewmat, atol=1e-4)
    ]
    if not set(moved) <= set(known) or 3 * len(moved) >= max(len(manifest.cameras), 1):
        name = next((name for name in moved if name not in known), moved[0] if moved else "")
        raise UsageError(
            f"{reel}: was made with a camera {name!r} that {capture.path} does not have in that place. "
            "Give the capture that the reel was made from."
        )


def check_unseen(manifest: Manifest, views: Sequence[Camera], reel: str) -> None:
    """Raise `UsageError` if the reel was trained on one of the views."""
    seen = sorted({camera.name for camera in manifest.cameras} & {view.name for view in views})
    if seen:
        raise UsageError(
            f"{reel}: was trained on {', '.join(seen)}, so they are not held out. Reconstruct without them, "
            "--hold-out NAME,NAME, or hold out what the reel has not seen."
        )


def reel_width(reel: str | Path) -> int:
    """Return the width in pixels of the images that the reel was made from."""
    return ReelReader(reel).manifest.camera.width


ERROR_GAIN = 4
"""Amplification of the displayed error: 1/4 of the range is white."""


def comparison(truth: np.ndarray, render: np.ndarray) -> np.ndarray:
    """Return truth, render and amplified absolute error side by side, uint8 [H, 3 W, 3]. Inputs are float images [H, W, 3] 0..1."""
    error = np.abs(truth - render) * ERROR_GAIN
    strip = np.concatenate([truth, render, error], axis=1)
    return (np.clip(strip, 0, 1) * 255 + 0.5).astype(np.uint8)


def write_png(path: Path, image: np.ndarray) -> None:
    """Write a uint8 image [H, W, 3] atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        Image.fromarray(image).save(temporary, format="PNG")
