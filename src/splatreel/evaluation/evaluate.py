"""Evaluation of a decoded reel against held-out cameras of its capture, or against training views."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import cast

import numpy as np

from splatreel.base import threads
from splatreel.base.atomic import sweep
from splatreel.base.errors import UsageError
from splatreel.base.process import peak_memory_bytes
from splatreel.base.progress import Progress, Silent, listed
from splatreel.capture.base import Capture
from splatreel.capture.masks import is_doubtful
from splatreel.capture.reading import median_images, moving_pixels
from splatreel.codec.inspection import ReelInfo, reel_info
from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.evaluation import metrics
from splatreel.evaluation.comparison_images import chosen_frames, comparison, write_images, write_png
from splatreel.evaluation.metrics import Flicker, border_frames, psnr
from splatreel.evaluation.page.report_page import write_report_page
from splatreel.evaluation.perceptual import Lpips, load_lpips
from splatreel.evaluation.report import Report
from splatreel.play.timeline import Timeline
from splatreel.run.store import Store
from splatreel.scene.camera import Camera, angles_apart
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


@dataclass(frozen=True)
class Quality:
    """Image quality of one image, or the mean over several. A metric that was not measured is None.

    Attributes:
        psnr: PSNR in dB over all pixels and channels.
        psnr_per_channel: Mean of the PSNR of each channel, in dB.
        ssim: Structural similarity as the code of 3DGS computes it.
        lpips: LPIPS with VGG-16.
        lpips_alex: LPIPS with AlexNet.
        ssim_skimage: Structural similarity as scikit-image computes it, with a data range of 1.
        dssim1: (1 - SSIM) / 2 of scikit-image's SSIM with a data range of 1.
        dssim2: The same with a data range of 2, as papers get that leave the range of float images to scikit-image.
        psnr_color_fitted: PSNR in dB after the best gain for each color channel of the whole image.
        lpips_3dgs: LPIPS with VGG-16 as the code of 3DGS and most code that descends from it computes it: the network gets
            values of 0..1 where it expects -1..1, which gives about 9 % lower distances.
    """

    psnr: float
    psnr_per_channel: float
    ssim: float
    lpips: float | None = None
    lpips_alex: float | None = None
    ssim_skimage: float | None = None
    dssim1: float | None = None
    dssim2: float | None = None
    psnr_color_fitted: float | None = None
    lpips_3dgs: float | None = None

    @staticmethod
    def mean(items: list[Quality]) -> Quality:
        """Return the arithmetic mean of each metric over the items that have it. There must be an item."""
        names = [field.name for field in dataclasses.fields(Quality)]
        values = {name: [v for item in items if (v := getattr(item, name)) is not None] for name in names}
        return Quality(**{name: sum(found) / len(found) for name, found in values.items() if found})


class ImageComparison:
    """Comparison of an image with its truth. What every mask needs is computed once.

    Args:
        image: Rendered image, float32 [H, W, 3] 0..1.
        truth: Camera image of the same shape.
        lpips: LPIPS by network, alex and vgg; those left out are not measured.
        within: Pixels that colors are fitted to, [H, W] bool; None means all.

    Raises:
        UsageError: The shapes differ.
    """

    def __init__(
        self, image: np.ndarray, truth: np.ndarray, lpips: Mapping[str, Lpips], within: np.ndarray | None = None
    ) -> None:
        metrics.check_images(image, truth, within)
        self._images = image, truth
        self._error = metrics.squared_error(image, truth)
        self._fitted = metrics.squared_error(metrics.fit_colors(image, truth, within), truth)
        self._gaussian = metrics.gaussian_moments(image, truth).similarity(1.0)
        has_windows = min(image.shape[:2]) >= metrics.UNIFORM_WINDOW
        uniform = metrics.uniform_moments(image, truth) if has_windows else None
        self._uniform = [uniform and uniform.similarity(data_range) for data_range in (1.0, 2.0)]
        self._lpips = {network: lpips[network].distances(image, truth) for network in lpips}
        if "vgg" in lpips:
            self._lpips["3dgs"] = lpips["vgg"].distances(image, truth, shifted=False)

    def quality(self, where: np.ndarray | None = None) -> Quality:
        """Return all metrics over the pixels of a mask [H, W] bool; None means all pixels.

        Raises:
            UsageError: The mask chooses no pixel, or has another shape.
        """
        metrics.check_images(*self._images, where)
        one, two = (None if map_ is None else metrics.mean_inside(map_, where) for map_ in self._uniform)
        perceived = {name: None if found is None else found.mean(where) for name, found in self._lpips.items()}
        return Quality(
            psnr=metrics.mean_decibel(self._error, where),
            psnr_per_channel=metrics.mean_decibel_per_channel(self._error, where),
            ssim=float(np.mean(self._gaussian if where is None else self._gaussian[where])),
            lpips=perceived.get("vgg"),
            lpips_alex=perceived.get("alex"),
            ssim_skimage=one,
            dssim1=metrics.dssim(one),
            dssim2=metrics.dssim(two),
            psnr_color_fitted=metrics.mean_decibel(self._fitted, where),
            lpips_3dgs=perceived.get("3dgs"),
        )


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
    lpips_every: int = 10,
) -> Report:
    """Render the decoded reel from held-out cameras and measure its quality.

    Args:
        reel: Folder or URL of the reel.
        capture: Capture that the reel was made from, opened from the frame that the reel begins with (`open_reel_capture`).
        rendition: Name of a rendition; None chooses the best.
        cameras: Names of cameras; None uses the default of `choose_cameras`.
        out: Folder for report.json, report.md, report.html and images of each camera: truth, render and error of the
            middle, the worst and the median frame, and the layers of the worst.
        undecoded: Function from a frame to the Gaussians before encoding, for `psnr_undecoded`.
        frames: Frames to evaluate; None means all frames that the reel and the capture share.
        seconds: Wall time of earlier stages, for the report.
        device: Device of the reconstruction, for the report.
        progress: Progress display.
        most: Memory in bytes that decoding a file may take, see `ReelReader`.
        coverage: Sentences about the coverage of the cameras, for the report.
        lpips_every: Distance of the frames that LPIPS is measured at, since VGG takes longer than everything else; 1
            measures every frame, 0 none.

    Raises:
        UsageError: Cameras or frames do not match.
        MissingDependencyError: The weights of LPIPS are damaged.
    """
    started = time.monotonic()
    progress = progress or Silent()
    reader = ReelReader(reel, rendition, most)
    check_same_capture(reader.manifest, capture, str(reel))
    views = choose_cameras(capture, reader.manifest, cameras)
    names = [view.name for view in views]
    chosen = choose_frames(min(capture.frames, reader.frames), frames, reader.manifest.first_frame)
    if out is not None:
        for folder in (out, *(out / "pictures" / kind for kind in ("", "worst", "median", "layers"))):
            sweep(folder)
    scores = Scores(Timeline(reader), capture, views, border_frames(reader.manifest))
    lpips, lpips_frames = load_lpips() if lpips_every else {}, set(chosen[:: max(lpips_every, 1)])
    image = chosen[len(chosen) // 2]
    progress.stage(f"comparing with {', '.join(names)}", len(chosen))
    for done, (frame, truths) in enumerate(read_frames(capture, chosen, names), 1):
        images = scores.add(frame, truths, lpips if frame in lpips_frames else {}, undecoded)
        if out is not None and frame == image:
            for name, truth in zip(names, truths, strict=True):
                if name in images:
                    write_png(out / "pictures" / f"{name.replace('/', '_')}.png", comparison(truth, images[name]))
        progress.update(done, psnr=float(np.mean([quality.psnr for quality in scores.whole.values()] or [0.0])))
    if not scores.whole:
        raise UsageError(
            f"{capture.path}: {', '.join(names)} have none of these frames, or their masks are black. Evaluate other frames or cameras."
        )
    decoding = decode_ms_per_frame(reel, rendition, most)
    spent = {**(seconds or {}), "evaluate": round(time.monotonic() - started, 3)}
    report = replace(
        _summarize(scores, reel_info(reel, rendition), spent, device),
        unmasked=[name for name in capture.unmasked if name in (cameras or capture.held_out)],
        decode_ms_per_frame=decoding,
        lpips_frames=len(lpips_frames) if lpips else 0,
        coverage=list(coverage),
    )
    if out is not None:
        report.write(out)
        write_images(out / "pictures", scores.timeline, capture, scores.psnr())
        write_report_page(out, reel, most=most)
    return report


@dataclass(frozen=True)
class _Rendered:
    """An image [H, W, 3] of a camera to measure.

    Attributes:
        truth: Camera image [H, W, 3].
        median: The camera's median image [H, W, 3] uint8.
        within: Pixels [H, W] bool that are measured; None means all.
        before: PSNR before encoding; None if it is not measured.
    """

    name: str
    image: np.ndarray
    truth: np.ndarray
    median: np.ndarray
    within: np.ndarray | None
    before: float | None

    def measure(self, lpips: Mapping[str, Lpips] = MappingProxyType({})) -> tuple[Quality, Quality | None, float]:
        """Return the quality of the image, that of the pixels with motion if there are any, and the share of these pixels."""
        compared = ImageComparison(self.image, self.truth, lpips, self.within)
        moves = moving_pixels(self.truth, self.median)
        if self.within is not None:
            moves &= self.within
        moving = compared.quality(moves) if moves.any() else None
        return compared.quality(self.within), moving, float(moves.mean())


class Scores:
    """Measurements of a reel, frame by frame.

    Args:
        timeline: Reel to measure.
        capture: Capture to compare with.
        views: Cameras to compare with.
        borders: Frames that fade from one group to the next.

    Attributes:
        whole: Quality of whole images, by frame and camera.
        moving: Quality of the pixels with motion, by frame and camera; images without motion are left out.
        moving_share: Share of pixels with motion in each image.
        masked_share: Share of pixels within the masks in each image, if there are masks. Only these are measured.
        before: PSNR of each image before encoding.
        flicker: Flicker of the images.
    """

    def __init__(self, timeline: Timeline, capture: Capture, views: Sequence[Camera], borders: set[int]) -> None:
        self.timeline = timeline
        self.capture = capture
        self.views = views
        self.medians = median_images(capture, [view.name for view in views])
        self.whole: dict[tuple[int, str], Quality] = {}
        self.moving: dict[tuple[int, str], Quality] = {}
        self.moving_share: list[float] = []
        self.masked_share: list[float] = []
        self.before: list[float] = []
        self.render_seconds: list[float] = []
        self.flicker = Flicker(borders)

    def add(
        self,
        frame: int,
        truths: np.ndarray,
        lpips: Mapping[str, Lpips],
        undecoded: Callable[[int], Gaussians] | None,
    ) -> dict[str, np.ndarray]:
        """Render a frame from the views that have it, measure it, and return the images by camera."""
        gaussians = self.timeline.at(frame / self.timeline.fps)
        raw = undecoded(frame) if undecoded is not None else None
        rendered: list[_Rendered] = []
        alpha = self.capture.alpha(frame, 1, [view.name for view in self.views])
        missing = self.capture.missing(frame, 1, [view.name for view in self.views])[0]
        for number, (view, truth, median, absent) in enumerate(
            zip(self.views, truths, self.medians, missing, strict=True)
        ):
            within = None if alpha is None else (alpha[0, number] > 0) & ~is_doubtful(alpha[0, number])
            if absent or (within is not None and not within.any()):
                continue
            begun = time.perf_counter()
            image = np.clip(self.timeline.render(gaussians, view), 0, 1)
            self.render_seconds.append(time.perf_counter() - begun)
            before = None
            if raw is not None:
                before = psnr(np.clip(self.timeline.render(raw, view), 0, 1), truth, within)
            rendered.append(_Rendered(view.name, image, truth, median, within, before))
        # The matrix products of LPIPS run on all threads themselves.
        measured = (
            [one.measure(lpips) for one in rendered] if lpips else threads.map_parallel(_Rendered.measure, rendered)
        )
        for one, (whole, moving, moving_share) in zip(rendered, measured, strict=True):
            self.whole[frame, one.name] = whole
            if one.within is not None:
                self.masked_share.append(float(one.within.mean()))
            self.moving_share.append(moving_share)
            if moving is not None:
                self.moving[frame, one.name] = moving
            self.flicker.add(frame, one.name, one.image, one.truth)
            if one.before is not None:
                self.before.append(one.before)
        return {one.name: one.image for one in rendered}

    def psnr(self) -> dict[str, dict[int, float]]:
        """Return the PSNR by camera and frame."""
        found: dict[str, dict[int, float]] = {}
        for (frame, name), quality in self.whole.items():
            found.setdefault(name, {})[frame] = quality.psnr
        return found


def _summarize(scores: Scores, info: ReelInfo, seconds: dict[str, float], device: str) -> Report:
    whole, views, reader = scores.whole, scores.views, scores.timeline.reel
    frames = sorted({frame for frame, _ in whole})
    names = list(dict.fromkeys(name for _, name in whole))
    trained_on = [camera.name for camera in reader.manifest.cameras]
    degrees, of_camera = _degrees_from(reader.manifest, views), scores.psnr()
    alive = [int(reader.group(entry.group).alive.sum()) for entry in reader.manifest.groups]
    return Report(
        **asdict(Quality.mean(list(whole.values()))),
        moving=asdict(Quality.mean(list(scores.moving.values()))) if scores.moving else None,
        moving_share=float(np.mean(scores.moving_share)),
        masked_share=float(np.mean(scores.masked_share)) if scores.masked_share else None,
        psnr_undecoded=float(np.mean(scores.before)) if scores.before else None,
        flicker=scores.flicker.mean(at_borders=False),
        flicker_borders=scores.flicker.mean(at_borders=True),
        reel_bytes=info.bytes,
        first_view_bytes=info.first_view_bytes,
        bytes_per_second=info.bytes_per_second,
        total_bytes=info.total_bytes,
        start_bytes=info.start_bytes,
        playing_bytes_per_second=info.playing_bytes_per_second,
        bytes_by_kind=info.bytes_by_kind,
        render_fps=1 / float(np.median(scores.render_seconds)),
        seconds=seconds,
        points_static=float(np.mean(alive)),
        points_dynamic=float(np.mean([g.points for g in reader.manifest.groups])),
        peak_memory_bytes=peak_memory_bytes(),
        device=device,
        frames=len(frames),
        width=views[0].width,
        height=views[0].height,
        cameras=[
            {"name": view.name}
            | asdict(Quality.mean([whole[f, view.name] for f in frames if (f, view.name) in whole]))
            | {"degrees": degrees[view.name]}
            | {f"{kind}_frame": frame for kind, frame in chosen_frames(of_camera[view.name]).items()}
            | {"camera": view.to_dict()}
            for view in views
            if view.name in of_camera
        ],
        trained_on=trained_on,
        held_out=[name for name in names if name not in trained_on],
        per_frame=[
            {"frame": f} | asdict(Quality.mean([whole[f, n] for n in names if (f, n) in whole])) for f in frames
        ],
    )


_SAMPLED_GROUPS = 5
"""Maximum number of groups that are decoded to measure the time of decoding."""


def decode_ms_per_frame(reel: str | Path, rendition: str | None, most: int | None) -> float:
    """Return the milliseconds to read and decode one frame of video, as the mean over evenly spread groups.

    The static points that are born at a group count for it. A group's time is divided by its frames.
    """
    reader = ReelReader(reel, rendition, most)
    entries = reader.manifest.groups
    places = np.linspace(0, len(entries) - 1, min(_SAMPLED_GROUPS, len(entries))).round().astype(int)
    born: dict[int, list[int]] = {}
    for index, layer in enumerate(reader.manifest.layers):
        born.setdefault(layer.group, []).append(index)
    begun = time.perf_counter()
    for entry in (entries[place] for place in places):
        reader.group(entry.group)
        for index in born.get(entry.group, []):
            reader.layer(index)
    return 1000 * (time.perf_counter() - begun) / sum(entries[place].frames for place in places)


def _degrees_from(manifest: Manifest, views: Sequence[Camera]) -> dict[str, float | None]:
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
    """Return the cameras to evaluate, without those that have no masks.

    `names`: Names of cameras. None means those that the reel says were held out. Without these, it means the capture's
    held-out cameras that the reel was not trained on, or all of them if the reel was trained on each.

    Raises:
        UsageError: There are no cameras, none has masks, or there is a mix of held-out and training views, whose mean would be
            meaningless.
    """
    trained = {camera.name for camera in manifest.cameras}
    if names is None:
        known = manifest.source.held_out if manifest.source else ()
        names = known or [name for name in capture.held_out if name not in trained] or capture.held_out
    if not names:
        raise UsageError(f"{capture.path}: no camera is held out. Name the cameras to evaluate: --cameras NAME,NAME.")
    seen = [name for name in names if name in trained]
    if seen and len(seen) < len(names):
        raise UsageError(
            f"--cameras {','.join(names)}: the reel was trained on {', '.join(seen)} and not on the others. "
            "Evaluate one kind at a time."
        )
    masked = [name for name in names if name not in capture.unmasked]
    if not masked:
        raise UsageError(
            f"{capture.path}: there are no masks of {listed(list(names))}, so the subject cannot be compared with their images. Add "
            f"masks to the folder, or name cameras that have masks: --cameras NAME,NAME."
        )
    return [capture.camera(name) for name in masked]


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
    """Raise `UsageError` if the reel was made with other cameras or from another first frame than the capture's.

    Up to a third of the cameras may have another pose, because training corrects poses (`method/cameras/poses.py`).
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
            "Give the capture that the reel was made from. If the reel was moved by `edit`, evaluate it before the move."
        )
    start = manifest.source.frame if manifest.source else None
    if start is not None and start != capture.first_frame:
        first, end = start + manifest.first_frame, start + manifest.frames
        raise UsageError(
            f"{reel}: shows frames {first}:{end} of its capture, and {capture.path} was opened from frame {capture.first_frame} on. "
            f"Open it with frames=({start}, {end})."
        )


class UncompressedReel:
    """Checkpoints in the shape of a reel reader, to measure the cost of compression."""

    def __init__(self, work: Path, reel: Path) -> None:
        reader = ReelReader(reel)
        self.store = Store(work)
        self.manifest: Manifest = reader.manifest
        self.fps = reader.fps
        self.frames = reader.frames
        self.duration = reader.duration
        self.name = str(work)

    def group(self, index: int) -> Group:
        """Return a group as trained."""
        return self.store.group(index).group().group

    def static(self, group: int) -> tuple[Gaussians, np.ndarray]:
        """Return the static points that `alive` of a group refers to, as trained, and the group at which each was born."""
        layers = self.store.layers(group)
        if not layers:
            return Gaussians.empty(0), np.zeros(0, np.int64)
        born = np.repeat([birth for birth, _ in layers], [len(layer.trained) for _, layer in layers])
        return Gaussians.concatenate([layer.trained for _, layer in layers]), born


def uncompressed_frames(work: Path, reel: Path) -> Callable[[int], Gaussians]:
    """Return a function from a frame to all Gaussians visible at it, from the checkpoints in `work` instead of the reel's files.

    Raises:
        ReconstructionError: A checkpoint is missing or damaged.
    """
    timeline = Timeline(cast(ReelReader, UncompressedReel(work, reel)))
    return lambda frame: timeline.at(frame / timeline.fps)
