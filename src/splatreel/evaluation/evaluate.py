"""Compare a reel, as decoded, with the cameras of its capture that training has not seen, or with those that it has."""

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
    """Render the decoded reel from held-out cameras and measure it; `out` gets report.json, report.md and pictures.

    rendition: of the reel, the best by default. cameras: names, see `choose_cameras` for the default. undecoded: frame
    -> the Gaussians before encoding, for psnr_undecoded. frames: which, all that both have by default. seconds: wall time of earlier
    stages, device: where they ran, coverage: sentences on the cameras; these only go into the report. most: bytes of memory that a file
    may take, see `ReelReader`.
    The picture of each camera, truth | render | error, is of the middle frame.
    Raises `UsageError` for cameras or frames that do not fit, and what reading the reel and the capture raises.
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
    """All metrics of one image against its truth, both float32 [H, W, 3] 0..1.

    where: [H, W] bool, only these pixels count; LPIPS, which is of whole images, is left out then.
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
    """The report of the scores by (frame, camera name)."""
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
    """By view the angle to the nearest camera that the reel was trained on, seen from where they look; None where that is nowhere."""
    limits, trained = manifest.presentation.limits, list(manifest.cameras)
    if limits is None or not trained:
        return {view.name: None for view in views}
    angles = [angles_apart([view, *trained], np.array(limits.focus))[0, 1:].min() for view in views]
    return {view.name: round(float(angle), 2) for view, angle in zip(views, angles, strict=True)}


def read_frames(capture: Capture, frames: list[int], names: list[str]):
    """Yield (frame, float32 [C, H, W, 3] 0..1) for ascending frames, reading neighbors together."""
    for first in range(0, len(frames), CHUNK):
        chunk = frames[first : first + CHUNK]
        together = chunk[-1] - chunk[0] + 1 == len(chunk)
        images = capture.read(chunk[0], len(chunk), names) if together else None
        for i, frame in enumerate(chunk):
            truths = images[i] if images is not None else capture.read(frame, 1, names)[0]
            yield frame, truths.astype(np.float32) / 255


def choose_cameras(capture: Capture, manifest: Manifest, names: Sequence[str] | None) -> list[Camera]:
    """The cameras of those names; by default those that the capture holds out and the reel has not seen, or all that the capture holds
    out where the reel was trained on each of them.

    Raises `UsageError` if there are none, and for names of both kinds, of which a mean would tell nothing.
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
    """Frames in order, by default all from `first` to the one before `available`. Raises `UsageError` for another."""
    chosen = list(range(first, available)) if frames is None else sorted(set(frames))
    bad = [f for f in chosen if not first <= f < available]
    if bad or not chosen:
        raise UsageError(
            f"Frames {bad or 'none'} cannot be evaluated: reel and capture share frames {first} to {available - 1}."
        )
    return chosen


def check_same_capture(manifest: Manifest, capture: Capture, reel: str) -> None:
    """Raise `UsageError` if the reel was made with other cameras than the capture's.

    Fewer than a third may stand elsewhere: training has put them right (`recon/cameras/poses.py`).
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
    """Raise `UsageError` for a reel that was trained on one of the views."""
    seen = sorted({camera.name for camera in manifest.cameras} & {view.name for view in views})
    if seen:
        raise UsageError(
            f"{reel}: was trained on {', '.join(seen)}, which cannot be held out of it any more. Reconstruct without them, "
            "--hold-out NAME,NAME, or hold out what the reel has not seen."
        )


def reel_width(reel: str | Path) -> int:
    """Width in pixels of the images that the reel was made from."""
    return ReelReader(reel).manifest.camera.width


ERROR_GAIN = 4
"""The error is shown four times as bright: 1/4 of the range is white."""


def comparison(truth: np.ndarray, render: np.ndarray) -> np.ndarray:
    """Truth, render and amplified absolute error side by side. Two float images [H, W, 3] 0..1 -> uint8 [H, 3 W, 3]."""
    error = np.abs(truth - render) * ERROR_GAIN
    strip = np.concatenate([truth, render, error], axis=1)
    return (np.clip(strip, 0, 1) * 255 + 0.5).astype(np.uint8)


def write_png(path: Path, image: np.ndarray) -> None:
    """Write a uint8 [H, W, 3] image, at once."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        Image.fromarray(image).save(temporary, format="PNG")
