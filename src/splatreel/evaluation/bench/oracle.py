"""The oracle: single frames reconstructed each on its own, compared with held-out cameras. It shows what geometry and cameras allow.

No motion, layers or cross-fade can go wrong there, so every dynamic result is judged by its distance to this. It is also the
baseline "3DGS per frame", with its bytes and its seconds.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from splatreel.capture.base import Capture
from splatreel.codec.group_file import decode_layer, encode_layer
from splatreel.config import Config
from splatreel.config.records import updated
from splatreel.errors import UsageError
from splatreel.evaluation import perceptual
from splatreel.evaluation.bench.oracle_report import OracleReport, Score, SingleFrame
from splatreel.evaluation.evaluate import check_same_capture, check_unseen, measure
from splatreel.evaluation.report import Quality, write_text
from splatreel.kernels.image import render_image
from splatreel.play.timeline import Timeline, open_reel
from splatreel.progress import Progress, Silent
from splatreel.recon.encode.importance import weigh
from splatreel.recon.run import checkpoint
from splatreel.recon.run.device import pick_device
from splatreel.recon.run.requirements import check_capture
from splatreel.recon.run.run_record import differences
from splatreel.recon.train.single_frame import reconstruct_single_frame
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
    """Reconstruct frames each on its own and measure them, and the same frames of a reel, on the held-out cameras.

    frames: counted within the capture's range, as the reel counts them. OUT/oracle.json gets each frame as it is finished, so that
    the same call continues an interrupted one, and OUT/oracle.md the tables. Raises `UsageError` where no camera is held out, a
    frame is not there, OUT holds frames of another capture or configuration, or the reel was made from other cameras, and what
    reading and reconstruction raise.
    """
    check_capture(capture)
    chosen, views = pick_device(device), held_out_views(capture)
    timeline = open_reel(reel) if reel is not None else None
    if timeline is not None:
        check_reel(timeline, capture, str(reel))
    frames = check_frames(frames, capture, timeline)
    finished = OracleFrames(Path(out) / "oracle.json", capture, config)
    progress, names, lpips = progress or Silent(), [view.name for view in views], perceptual.load()
    medians = median_pictures(capture, names)
    todo = [frame for frame in frames if frame not in finished.frames]
    scores: list[Score] = []
    for frame in frames:
        truths = capture.read(frame, 1, names)[0].astype(np.float32) / 255
        masks = [moving_pixels(truth, median) for truth, median in zip(truths, medians, strict=True)]
        held_out = HeldOutPictures(views, truths, masks, lpips)
        if frame in todo:
            done = todo.index(frame)
            title, span = (
                f"frame {frame} on its own ({done + 1} of {len(todo)})",
                (done / len(todo), (done + 1) / len(todo)),
            )
            progress.stage(title, config.keyframe.first_iterations, span)
            finished.add(reconstruct_frame(capture, frame, config, held_out, chosen, progress))
        if timeline is not None:
            scores.append(held_out.score(timeline.at(frame / timeline.fps), timeline.render))
    report = OracleReport([finished.frames[frame] for frame in frames], scores)
    finished.save(report.reel_dict(str(reel)) if reel is not None else None)
    write_text(Path(out) / "oracle.md", report.to_markdown())
    return report


def reconstruct_frame(
    capture: Capture, frame: int, config: Config, held_out: HeldOutPictures, device: torch.device, progress: Progress
) -> SingleFrame:
    """Reconstruct one frame from its own images alone, encode and measure it."""
    cameras = capture.training_cameras
    images = capture.read(frame, 1, [camera.name for camera in cameras])[0]
    first = capture.first_frame + frame == 0  # sparse points that a capture brings are of its first frame
    start = time.monotonic()
    gaussians, layout = reconstruct_single_frame(
        cameras,
        images,
        config,
        points=capture.points if first else None,
        point_colors=capture.point_colors if first else None,
        near=capture.near,
        device=device,
        progress=progress,
    )
    seconds = round(time.monotonic() - start, 3)
    shows = weigh([gaussians], cameras, layout.near, device, config.antialias)
    data, _ = encode_layer(0, frame, gaussians, config.encode, importance=shows)
    _, decoded = decode_layer(data, f"frame {frame}")
    draw = partial(render_image, near=layout.near, antialias=config.antialias, background=layout.background)
    score, after = held_out.score(gaussians, draw), held_out.score(decoded, draw)
    return SingleFrame(frame, score, after.whole, len(gaussians), len(data), seconds, device.type)


@dataclass(frozen=True)
class HeldOutPictures:
    """The held-out pictures of one frame. truths: float32 [C, H, W, 3] 0..1. masks: C of [H, W] bool, where something moves."""

    views: list[Camera]
    truths: np.ndarray
    masks: list[np.ndarray]
    lpips: perceptual.Distance | None

    def score(self, gaussians: Gaussians, draw: Callable[[Gaussians, Camera], np.ndarray]) -> Score:
        """Draw Gaussians from every view and compare; the mean over the views, inside the masks over those that have any."""
        whole: list[Quality] = []
        moving: list[Quality] = []
        for view, truth, mask in zip(self.views, self.truths, self.masks, strict=True):
            image = np.clip(draw(gaussians, view), 0, 1)
            whole.append(measure(image, truth, self.lpips))
            if mask.any():
                moving.append(measure(image, truth, None, mask))
        return Score(Quality.mean(whole), Quality.mean(moving) if moving else None)


def held_out_views(capture: Capture) -> list[Camera]:
    """The held-out cameras. Raises `UsageError` if there are none."""
    if not capture.held_out:
        raise UsageError(
            f"{capture.path}: no camera is held out, so there is nothing to compare with. Name some: --hold-out NAME,NAME."
        )
    return [capture.camera(name) for name in capture.held_out]


def check_frames(frames: list[int], capture: Capture, timeline: Timeline | None) -> list[int]:
    """Frames in order, each once. Raises `UsageError` for none, or one that the capture or the reel does not have."""
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
    """Raises `UsageError` for a reel of another capture, or one that has seen what is held out."""
    check_same_capture(timeline.manifest, capture, reel)
    check_unseen(timeline.manifest, held_out_views(capture), reel)


VERSION = 1
"""Raised when frames of before cannot be compared with new ones."""
DECIDING = ("keyframe", "encode", "correct_colors", "seed")
"""The fields of `Config` that a single frame depends on."""


class OracleFrames:
    """The finished frames of one capture and configuration, in a file that is replaced whenever one is added.

    Raises `UsageError` where the file holds those of another, `ReconstructionError` where it cannot be read.
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
        found = checkpoint.load_json(self.path)
        theirs: dict[str, Any] = found if isinstance(found, dict) else {}
        settings = updated(theirs.get("config"))
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
        self.frames[frame.frame] = frame
        self.save(None)

    def save(self, reel: dict[str, Any] | None) -> None:
        frames = [dataclasses.asdict(self.frames[number]) for number in sorted(self.frames)]
        checkpoint.save_json(self.path, self.record | {"frames": frames, "reel": reel})


THRESHOLD = 8 / 255
"""Mean absolute difference of the channels, 0..1, from the camera's median picture."""
MOST_FRAMES = 20
"""Frames that the median is taken of."""


def median_pictures(capture: Capture, names: list[str]) -> list[np.ndarray]:
    """The median over the capture's frames of each named camera, uint8 [H, W, 3].

    At most 20 frames, spread evenly over all; of an even number the lower middle. One camera's frames are held at a time. Raises
    what reading the capture raises.
    """
    times = np.linspace(0, capture.frames - 1, min(MOST_FRAMES, capture.frames)).round().astype(int)
    middle = (len(times) - 1) // 2
    pictures = []
    for name in names:
        stack = np.stack([capture.read(int(time), 1, [name])[0, 0] for time in times])
        stack.partition(middle, axis=0)
        pictures.append(stack[middle].copy())
    return pictures


def moving_pixels(truth: np.ndarray, median: np.ndarray) -> np.ndarray:
    """[H, W] bool: where a picture, float32 [H, W, 3] 0..1, is not as its camera's median picture, uint8 [H, W, 3]."""
    return np.abs(truth - median.astype(np.float32) / 255).mean(-1) > THRESHOLD
