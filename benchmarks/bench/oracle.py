"""Oracle: single frames reconstructed independently and compared with held-out cameras.

It shows the quality that geometry and cameras allow, without errors of motion, layers or cross-fades. Reels are judged
by their distance to it. It is also the baseline "3DGS per frame", with its size and time.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.oracle_report import OracleReport, Score, SingleFrame
from bench.provenance import check_unseen
from splatreel.base.errors import UsageError
from splatreel.base.progress import Progress, Silent
from splatreel.capture.base import Capture
from splatreel.capture.reading import median_images, moving_pixels
from splatreel.codec.group_file import decode_layer, encode_layer
from splatreel.config import Config
from splatreel.config.settings import complete_settings
from splatreel.evaluation.evaluate import ImageComparison, Quality, check_same_capture
from splatreel.evaluation.perceptual import Lpips, load_lpips
from splatreel.evaluation.report import write_text
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.kernels.image import render_image
from splatreel.method.encode.compression import weigh
from splatreel.method.init.layout import Layout
from splatreel.method.train.single_frame import reconstruct_single_frame
from splatreel.play.timeline import Timeline, open_reel
from splatreel.run.device_choice import pick_gpu
from splatreel.run.requirements import check_capture
from splatreel.run.run_folder import differences
from splatreel.run.store import load_json, save_json
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians


def oracle(
    capture: Capture,
    out: Path,
    config: Config,
    frames: list[int],
    *,
    reel: Path | None = None,
    device: str = "auto",
    progress: Progress | None = None,
) -> OracleReport:
    """Reconstruct single frames, and measure them and the same frames of a reel on the held-out cameras.

    OUT/oracle.json receives each finished frame, so the same call continues after an interruption. OUT/oracle.md
    receives the tables.

    Args:
        capture: Capture with held-out cameras.
        out: Output folder.
        config: Configuration.
        frames: Frames within the capture's range, as the reel counts them.
        reel: Reel to compare; None compares nothing.
        device: auto, cpu, gpu or cuda.
        progress: Progress display.

    Raises:
        UsageError: No camera is held out, a frame does not exist, OUT belongs to another capture or configuration, or
            the reel was made with other cameras.
    """
    check_capture(capture)
    config = config.for_video(capture.frames)
    (gpu, note), views = pick_gpu(device), held_out_views(capture)
    timeline = open_reel(reel) if reel is not None else None
    if timeline is not None:
        check_reel(timeline, capture, str(reel))
    frames = check_frames(frames, capture, timeline)
    finished = OracleFrames(Path(out) / "oracle.json", capture, config)
    progress, names, lpips = progress or Silent(), [view.name for view in views], load_lpips()
    if note:
        progress.note(note)
    medians = median_images(capture, names)
    todo = [frame for frame in frames if frame not in finished.frames]
    scores: list[Score] = []
    for frame in frames:
        truths = capture.read(frame, 1, names)[0].astype(np.float32) / 255
        masks = [moving_pixels(truth, median) for truth, median in zip(truths, medians, strict=True)]
        held_out = HeldOutImages(views, truths, masks, lpips)
        if frame in todo:
            done = todo.index(frame)
            title, span = (
                f"frame {frame} by itself ({done + 1} of {len(todo)})",
                (done / len(todo), (done + 1) / len(todo)),
            )
            progress.stage(title, config.keyframe.first_iterations, span)
            finished.add(reconstruct_frame(capture, frame, config, held_out, gpu, progress))
        if timeline is not None:
            scores.append(held_out.score(timeline.at(frame / timeline.fps), timeline.render))
    report = OracleReport([finished.frames[frame] for frame in frames], scores)
    finished.save(report.reel_dict(str(reel)) if reel is not None else None)
    write_text(Path(out) / "oracle.md", report.to_markdown())
    return report


def reconstruct_frame(
    capture: Capture, frame: int, config: Config, held_out: HeldOutImages, gpu: SharedGpu | None, progress: Progress
) -> SingleFrame:
    """Reconstruct one frame from its own images, encode and measure it."""
    cameras = capture.training_cameras
    missing = capture.missing(frame, 1, [camera.name for camera in cameras])[0]
    cameras = [camera for camera, absent in zip(cameras, missing, strict=True) if not absent]
    images = capture.read(frame, 1, [camera.name for camera in cameras])[0]
    first = capture.first_frame + frame == 0  # the capture's sparse points belong to its first frame
    start = time.monotonic()
    gaussians, layout = reconstruct_single_frame(
        cameras,
        images,
        config,
        points=capture.points if first else None,
        point_colors=capture.point_colors if first else None,
        near=capture.near,
        gpu=gpu,
        progress=progress,
    )
    seconds = round(time.monotonic() - start, 3)
    shows = weigh([gaussians], cameras, layout.near, config.antialias)
    data, _ = encode_layer(0, frame, gaussians, config.encode, importance=shows)
    _, decoded = decode_layer(data, f"frame {frame}")
    draw = partial(draw_single_frame, layout, config.antialias)
    score, after = held_out.score(gaussians, draw), held_out.score(decoded, draw)
    return SingleFrame(
        frame, score, after.whole, len(gaussians), len(data), seconds, "cpu" if gpu is None else gpu.kind
    )


def draw_single_frame(layout: Layout, antialias: bool, gaussians: Gaussians, view: Camera) -> np.ndarray:
    """Draw the points of a single frame as a reel draws static points: without those that its `Clearance` hides from the view."""
    seen = gaussians[~layout.clearance.hides(gaussians.means, view)]
    return render_image(seen, view, near=layout.near, antialias=antialias, background=layout.background)


@dataclass(frozen=True)
class HeldOutImages:
    """Held-out images of one frame.

    Attributes:
        views: Held-out cameras, C.
        truths: Camera images, float32 [C, H, W, 3] 0..1.
        masks: Pixels with motion, C of [H, W] bool.
        lpips: LPIPS by network; empty without weights.
    """

    views: list[Camera]
    truths: np.ndarray
    masks: list[np.ndarray]
    lpips: Mapping[str, Lpips]

    def score(self, gaussians: Gaussians, draw: Callable[[Gaussians, Camera], np.ndarray]) -> Score:
        """Draw Gaussians from every view and return the mean score over views; `moving` uses the views with a non-empty mask."""
        whole: list[Quality] = []
        moving: list[Quality] = []
        for view, truth, mask in zip(self.views, self.truths, self.masks, strict=True):
            image = np.clip(draw(gaussians, view), 0, 1)
            compared = ImageComparison(image, truth, self.lpips)
            whole.append(compared.quality())
            if mask.any():
                moving.append(compared.quality(mask))
        return Score(Quality.mean(whole), Quality.mean(moving) if moving else None)


def held_out_views(capture: Capture) -> list[Camera]:
    """Return the held-out cameras. Raise `UsageError` if there are none."""
    if not capture.held_out:
        raise UsageError(
            f"{capture.path}: no camera is held out, so there is nothing to compare with. Name some: --hold-out NAME,NAME."
        )
    return [capture.camera(name) for name in capture.held_out]


def check_frames(frames: list[int], capture: Capture, timeline: Timeline | None) -> list[int]:
    """Return sorted distinct frames. Raise `UsageError` if there are none, or if the capture or the reel lacks one."""
    first, available = 0, capture.frames
    if timeline is not None:
        first, available = timeline.manifest.first_frame, min(capture.frames, timeline.frames)
    bad = [frame for frame in frames if not first <= frame < available]
    if bad or not frames:
        whose = f"{capture.path} has" if timeline is None else f"{capture.path} and the reel share"
        raise UsageError(
            f"Frames {bad or 'none'} were asked for; {whose} frames {first} to {available - 1}. Choose among these."
        )
    return sorted(set(frames))


def check_reel(timeline: Timeline, capture: Capture, reel: str) -> None:
    """Raise `UsageError` for a reel of another capture, or one trained on held-out cameras."""
    check_same_capture(timeline.manifest, capture, reel)
    check_unseen(timeline.manifest, held_out_views(capture), reel)


VERSION = 2
"""Increase when earlier frames cannot be compared with new ones."""
DECIDING = ("keyframe", "encode", "correct_colors", "seed")
"""Fields of `Config` that affect a single frame."""


class OracleFrames:
    """Finished frames of a capture and configuration, in a file that is replaced after each frame.

    Raises:
        UsageError: The file belongs to another capture or configuration.
        ReconstructionError: The file cannot be read.
    """

    def __init__(self, path: Path, capture: Capture, config: Config) -> None:
        decide = json.loads(config.to_json())
        self.path = path
        self.record: dict[str, Any] = {
            "version": VERSION,
            "capture": capture.describe(),
            "config": {name: decide[name] for name in DECIDING},
        }
        self.frames: dict[int, SingleFrame] = self._load() if path.exists() else {}

    def _load(self) -> dict[int, SingleFrame]:
        found = load_json(self.path)
        theirs: dict[str, Any] = found if isinstance(found, dict) else {}
        settings = complete_settings(theirs.get("config"))
        theirs = theirs | {"config": {name: settings.get(name) for name in DECIDING}}
        others = differences({name: theirs.get(name) for name in self.record}, self.record)
        if others:
            raise UsageError(
                f"{self.path}: holds frames of another capture or configuration: {'; '.join(others[:3])}. "
                "Choose another --out, ask for the same again, or delete the file to start over."
            )
        try:
            return {frame["frame"]: SingleFrame.from_dict(frame) for frame in theirs["frames"]}
        except (KeyError, TypeError, AttributeError) as error:
            raise UsageError(f"{self.path}: is damaged ({error!r}). Delete it to start over.") from error

    def add(self, frame: SingleFrame) -> None:
        """Add a frame and write the file."""
        self.frames[frame.frame] = frame
        self.save(None)

    def save(self, reel: dict[str, Any] | None) -> None:
        """Write the file with the results of the reel, if any."""
        frames = [dataclasses.asdict(self.frames[number]) for number in sorted(self.frames)]
        save_json(self.path, self.record | {"frames": frames, "reel": reel})
