"""The report page, OUT/report.html: a file without scripts of its own that needs no other file."""

from __future__ import annotations

import html
import statistics
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

from PIL import Image

from splatreel.base.command_line import quoted
from splatreel.base.errors import ReelError, SplatreelError
from splatreel.base.progress import Progress
from splatreel.codec.writer import ReelWriter
from splatreel.evaluation.comparison_images import image_file
from splatreel.evaluation.page.html import (
    Series,
    escape,
    html_list,
    html_page,
    html_table,
    jpeg_url,
    line_chart,
    section,
    with_code,
)
from splatreel.evaluation.page.rig_plan import RigPlan, rig_drawings
from splatreel.evaluation.page.run_facts import RunFacts
from splatreel.evaluation.report import (
    LPIPS_MISSING,
    Report,
    camera_table,
    megabytes,
    named_seconds,
    report_numbers,
    report_size,
    write_text,
)
from splatreel.method.prediction.quality import FAIR, rating
from splatreel.play.demo_page import refreshed, refreshed_policy
from splatreel.play.player_page import standalone_page
from splatreel.run.output.group_writer import PresentationHook
from splatreel.run.run_logs import LOGS

_CAMERA_BELOW = 3.0
"""A camera stands out if its PSNR is this many dB below the median of the others."""
_LOWEST = 3
"""Largest number of cameras that are named as those with the lowest PSNR."""
_MOMENT_BELOW = 2.0
"""A moment fails if its PSNR is this many dB below the median of the frames."""
MOMENTS = 3
"""Largest number of moments that are named, the worst first."""
_FALL = 1.0
"""Smallest fall of the PSNR in dB, between the medians of the first and the last quarter of the frames, that is worth a remark."""
_FALL_FRAMES = 16
"""Smallest number of frames in which a fall is looked for."""
_CODING_LOSS = 0.2
"""Loss by compression in dB that is worth a remark."""


@dataclass(frozen=True)
class Moment:
    """Consecutive frames with a low PSNR.

    Attributes:
        below: Largest distance to the median of all frames, dB.
    """

    first: int
    last: int
    below: float


def findings(report: Report, fps: float) -> list[str]:
    """Return sentences about the quality of a reel, the general one first.

    Args:
        report: Report of an evaluation.
        fps: Frames per second, for times.
    """
    kind = "Held-out cameras" if report.held_out else "Training cameras"
    found = [f"{kind} are rendered with {report.psnr:.1f} dB, which is {rating(report.psnr)}{_lowest(report)}."]
    if not report.held_out:
        found.append("No camera was held out, so the quality of novel views was not measured.")
    found += [*_cameras(report), *_fall(report), *_moments(report, fps)]
    return [*found, *_motion(report), *_flicker(report), *_coding(report)]


def failing_moments(report: Report) -> list[Moment]:
    """Return the moments whose PSNR is far below the median, in order of time."""
    if len(report.per_frame) < 3:
        return []
    middle = statistics.median(frame["psnr"] for frame in report.per_frame)
    low = [(f["frame"], middle - f["psnr"]) for f in report.per_frame if middle - f["psnr"] >= _MOMENT_BELOW]
    step = min((b["frame"] - a["frame"] for a, b in pairwise(report.per_frame)), default=1)
    moments: list[Moment] = []
    for frame, below in low:
        if moments and frame - moments[-1].last <= 2 * step:
            moments[-1] = Moment(moments[-1].first, frame, max(moments[-1].below, below))
        else:
            moments.append(Moment(frame, frame, below))
    return moments


def _lowest(report: Report) -> str:
    """Name the cameras with the lowest PSNR, where there are several."""
    if len(report.cameras) < 2:
        return ""
    order = sorted(report.cameras, key=lambda camera: camera["psnr"])[: min(_LOWEST, len(report.cameras) // 2)]
    named = ", ".join(f"{camera['name']} ({camera['psnr']:.1f} dB)" for camera in order)
    return f"; lowest: {named}"


def _cameras(report: Report) -> list[str]:
    found = []
    for camera in report.cameras:
        others = [other["psnr"] for other in report.cameras if other is not camera]
        if others and (below := statistics.median(others) - camera["psnr"]) >= _CAMERA_BELOW:
            found.append(
                f"Camera {camera['name']} is {below:.1f} dB below the others. Check its pose, its focus and its exposure: "
                "`splatreel capture check`."
            )
    return found


def _fall(report: Report) -> list[str]:
    """Return a sentence about a PSNR that gets lower and lower in the course of the video."""
    values = [frame["psnr"] for frame in report.per_frame]
    if len(values) < _FALL_FRAMES:
        return []
    edges = [len(values) * quarter // 4 for quarter in range(5)]
    quarters = [statistics.median(values[a:b]) for a, b in pairwise(edges)]
    fall = quarters[0] - quarters[-1]
    if fall < _FALL or any(later > earlier + _FALL / 4 for earlier, later in pairwise(quarters)):
        return []
    return [
        f"The PSNR falls over time: the median is {quarters[0]:.1f} dB in the first quarter of the frames and {quarters[-1]:.1f} dB in "
        "the last. The light or a camera may change slowly, or more moves at the end."
    ]


def _moments(report: Report, fps: float) -> list[str]:
    worst = sorted(failing_moments(report), key=lambda moment: -moment.below)[:MOMENTS]
    found = []
    for moment in sorted(worst, key=lambda moment: moment.first):
        frames = f"Frame {moment.first}" if moment.first == moment.last else f"Frames {moment.first} to {moment.last}"
        verb = "is" if moment.first == moment.last else "are up to"
        times = f"{moment.first / fps:.2f} s" if fps else "unknown time"
        found.append(
            f"{frames} (from {times}) {verb} {moment.below:.1f} dB below the median frame. Something moves fast, appears or "
            "changes its light there."
        )
    return found


def _motion(report: Report) -> list[str]:
    value = (report.moving or {}).get("psnr")
    if value is None or value >= FAIR:
        return []
    return [
        f"Moving parts are rendered with {value:.1f} dB, which is poor. More iterations may help: `--quality paper`."
    ]


def _flicker(report: Report) -> list[str]:
    within, borders = report.flicker, report.flicker_borders
    if within is None or borders is None or borders < 1.5 * within or borders < within + 0.3:
        return []
    return [
        f"The change between groups is visible: images flicker by {borders:.2f} gray levels there, otherwise by {within:.2f}."
    ]


def _coding(report: Report) -> list[str]:
    if report.psnr_undecoded is None or (loss := report.psnr_undecoded - report.psnr) < _CODING_LOSS:
        return []
    return [f"Compression costs {loss:.2f} dB. `splatreel encode --rate high` makes a larger reel with a smaller loss."]


_LARGEST_REEL = 64 << 20
"""Largest reel in bytes that is embedded."""
WIDEST = 640
"""Largest width of an embedded image in pixels."""
CAMERAS = 24
"""Largest number of cameras with images. The cameras with the lowest PSNR come first."""

Player = Literal["embedded", "beside", "none"]
"""Player of the page: embedded with the reel, that of the server at `./`, or none."""


def write_report_page(out: Path, reel: str | Path, player: Player = "embedded", most: int | None = None) -> None:
    """Write OUT/report.html atomically, from what is in the folders now.

    Args:
        out: Folder of report.json and images.
        reel: Folder or URL of the reel.
        player: Player of the page.
        most: Memory in bytes that decoding a file may take, see `ReelReader`.

    Raises:
        ReelError: There is no reel.
    """
    write_text(out / "report.html", report_page(RunFacts.read(out, reel, most), player))


def report_page(facts: RunFacts, player: Player) -> str:
    """Return the page as HTML."""
    title = facts.manifest.presentation.title or facts.record.get("capture", {}).get("name") or "Reel"
    sections = [
        f'<div id="summary">{_summary(facts)}</div>',
        section("Player", _player(facts, player), "screen"),
        section("Curves", _charts(facts)),
        section("Pictures", _images(facts)),
        section("Cameras", _rig(facts)),
        section("Numbers", _numbers(facts.report)),
        section("Groups", _groups(facts)),
        section("Run", _run(facts)),
    ]
    state = "This run is not finished: the page shows what there is so far." if facts.manifest.live else ""
    return html_page(f"Report: {title}", title, f"{_subtitle(facts)} {state}".strip(), sections)


def _subtitle(facts: RunFacts) -> str:
    manifest = facts.manifest
    frames = manifest.frames - manifest.first_frame
    cameras = f"{len(manifest.cameras)} cameras trained" + (
        f", {len(facts.held_out)} held out" if facts.held_out else ""
    )
    return f"{frames} frames, {frames / manifest.fps:.1f} s, {cameras}."


def _summary(facts: RunFacts) -> str:
    report, manifest = facts.report, facts.manifest
    size = report_size(report) if report else sum(entry.bytes for entry in manifest.files)
    tiles = [("Reel", megabytes(size))]
    if report is not None:
        moving = (report.moving or {}).get("psnr")
        tiles = [
            ("PSNR", f"{report.psnr:.2f} dB"),
            ("PSNR of moving pixels", "none moved" if moving is None else f"{moving:.2f} dB"),
            ("SSIM", f"{report.ssim:.4f}"),
            *([("LPIPS (VGG)", f"{report.lpips:.4f}")] if report.lpips is not None else []),
            *tiles,
            ("A second of video", megabytes(report.bytes_per_second)),
        ]
        sentences = findings(report, manifest.fps)
    else:
        sentences = [
            f"This reel was not evaluated yet: `{quoted(['splatreel', 'evaluate', facts.reel, 'CAPTURE', '--out', 'OUT'])}`."
        ]
    boxes = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in tiles)
    outstanding = html_list([*sentences, *facts.coverage])
    return f'<dl class="tiles">{boxes}</dl>\n{section("What stands out", outstanding, "findings")}'


def _player(facts: RunFacts, player: Player) -> str:
    manifest = facts.manifest
    if player == "beside" and manifest.groups:
        return _opened_on_demand('src="./"')
    if player == "embedded" and manifest.groups and not manifest.live:
        size = sum(entry.bytes for entry in manifest.files)
        with suppress(ReelError):  # the paper's codec cannot be embedded
            if size <= _LARGEST_REEL:
                return _opened_on_demand(f'srcdoc="{html.escape(standalone_page(facts.reel))}"')
    return f"<p>Play it with <code>{escape(quoted(['splatreel', 'serve', facts.reel]))}</code>.</p>"


def _opened_on_demand(source: str) -> str:
    """Return the player's frame, which loads when it is opened, since it keeps the processor busy without a GPU."""
    frame = f'<iframe {source} title="Player" allow="fullscreen" loading="lazy"></iframe>'
    return f"<details><summary>Play the reel here</summary>{frame}</details>"


def _charts(facts: RunFacts) -> str:
    groups = facts.groups()
    firsts = [group.first for group in groups]
    charts: list[str] = []

    def add(title: str, series: Series, x: str, y: str, **options: Any) -> None:
        if any(series.values()):
            charts.append(f"<section><h3>{title}</h3>{line_chart(series, x, y, **options)}</section>")

    if facts.report is not None:
        per_frame = [(frame["frame"], frame["psnr"]) for frame in facts.report.per_frame]
        add("PSNR of each frame", {"PSNR": per_frame}, "frame", "PSNR in dB", borders=firsts)
    if len(groups) > 1:
        add("Training loss", _losses(facts), "group", "training loss", x_range=(1, len(groups) + 1))
        number = [group.index + 1 for group in groups]
        points = {
            "static": list(zip(number, (group.static for group in groups), strict=True)),
            "dynamic": list(zip(number, (group.dynamic for group in groups), strict=True)),
        }
        add("Points of each group", points, "group", "points")
        sizes = [(group.index + 1, group.bytes / 1e3) for group in groups]
        add("Kilobytes of each group", {"kilobytes": sizes}, "group", "kilobytes")
        seconds = [(group.index + 1, group.seconds) for group in groups if group.seconds is not None]
        add("Seconds of each group", {"seconds": seconds}, "group", "seconds")
    else:  # a single point is not a curve
        losses = {name: [(100 * (x - 1), loss) for x, loss in points] for name, points in _losses(facts).items()}
        add("Training loss", losses, "% of the training", "training loss")
    return f'<div class="charts">{"".join(charts)}</div>' if charts else ""


def _losses(facts: RunFacts) -> dict[str, list[tuple[float, float]]]:
    """Return the training loss of keyframes and of motion. The curve of a group reaches from its number to the next."""
    found: dict[str, list[tuple[float, float]]] = {}
    for stage in facts.history.stages:
        curve = stage.curve("loss")
        if curve and stage.group is not None:
            name = "motion" if "motion" in stage.name else "keyframe"
            found.setdefault(name, []).extend((stage.group + 1 + share, loss) for share, loss in curve)
    return found


def _images(facts: RunFacts) -> str:
    report = facts.report
    if report is None:
        return ""
    cameras = sorted(report.cameras, key=lambda camera: camera["psnr"])[:CAMERAS]
    parts = [_camera(facts, camera) for camera in cameras]
    skipped = len(report.cameras) - len(cameras)
    note = f"<p class='soft'>{skipped} cameras with a higher PSNR are left out.</p>" if skipped else ""
    return "".join([*parts, note])


def _camera(facts: RunFacts, camera: dict) -> str:
    name, parts = camera["name"], []
    for kind in ("worst", "median"):
        panels = _panels(image_file(facts.images, kind, name), 3)
        frame = camera.get(f"{kind}_frame")
        names = ("Truth", "Render", "Error, four times")
        pairs = list(zip(names, panels, strict=False))
        if kind == "worst":
            pairs += [
                ("Layers: moving in blue", panel) for panel in _panels(image_file(facts.images, "layers", name), 1)
            ]
        figures = "".join(
            f'<figure><img src="{panel}" alt="{escape(f"{label}, {name}, frame {frame}")}"><figcaption>{label}</figcaption></figure>'
            for label, panel in pairs
        )
        if figures:
            time = "" if frame is None else f", frame {frame} ({frame / facts.manifest.fps:.2f} s)"
            parts.append(
                f'<div class="frame"><p>{kind.capitalize()} frame{time}</p><div class="strip">{figures}</div></div>'
            )
    return f"<h3>{escape(name)}: {camera['psnr']:.2f} dB</h3>{''.join(parts)}" if parts else ""


def _panels(path: Path, count: int) -> list[str]:
    """Return the panels of an image, side by side, as data URLs of JPEGs; none if the file is missing or damaged."""
    try:
        with Image.open(path) as image:
            image = image.convert("RGB")
    except (OSError, ValueError):
        return []
    width = image.width // count
    boxes = ((index * width, 0, (index + 1) * width, image.height) for index in range(count))
    return [jpeg_url(image.crop(box), WIDEST) for box in boxes]


def _rig(facts: RunFacts) -> str:
    manifest = facts.manifest
    if not manifest.cameras:
        return ""
    return rig_drawings(RigPlan(manifest.cameras, facts.held_out, manifest.up, facts.points))


def _numbers(report: Report | None) -> str:
    if report is None:
        return ""
    rows = [(number.name, number.value, number.meaning) for number in report_numbers(report)]
    missing = f"<p>{with_code(LPIPS_MISSING)}</p>" if report.lpips_frames == 0 else ""
    return "".join(
        [
            f"<p>{escape(report.views())}</p>{missing}",
            html_table(("Number", "Value", "Meaning"), rows),
            f"<h3>Cameras</h3>{html_table(*camera_table(report), 'counts')}",
        ]
    )


def _groups(facts: RunFacts) -> str:
    rows = [
        (
            str(group.index + 1),
            f"{group.first} to {group.end - 1}",
            f"{group.static:,}",
            f"{group.born:,}",
            f"{group.dynamic:,}",
            f"{group.bytes:,}",
            "" if group.seconds is None else f"{group.seconds:,.0f}",
            "" if group.psnr is None else f"{group.psnr:.2f}",
        )
        for group in facts.groups()
    ]
    heads = ("Group", "Frames", "Static points", "New static", "Dynamic points", "Bytes", "Seconds", "PSNR dB")
    moments = failing_moments(facts.report) if facts.report else []
    low = html_list(f"Frames {m.first} to {m.last}: up to {m.below:.1f} dB below the median" for m in moments)
    return (html_table(heads, rows, "counts") if rows else "") + (f"<h3>Moments that fail</h3>{low}" if low else "")


def _run(facts: RunFacts) -> str:
    """Return what was asked, on which machine, and how long each stage took."""
    capture = facts.record.get("capture", {})
    rows = [
        ("Capture", str(capture.get("name", ""))),
        ("Frames", str(capture.get("frames", ""))),
        ("Size", str(capture.get("size", ""))),
        ("Held out", ", ".join(map(str, capture.get("held_out", [])))),
        ("Quality", facts.quality()),
        ("Machine", "; ".join(facts.history.machines)),
        ("Written by", facts.manifest.generator),
    ]
    rows += [(f"Time of {name}", f"{value:,.1f} s") for name, value in named_seconds(facts.seconds).items()]
    notes = html_list(facts.history.notes)
    return html_table(("What", "Value"), [row for row in rows if row[1]]) + (f"<h3>Notes</h3>{notes}" if notes else "")


LEAST_SECONDS = 30.0
"""Smallest time between two pages of a run."""
_LARGEST_SHARE = 0.02
"""Largest share of a run's time that its pages take."""


class ReportWriter:
    """Hook of a run that writes OUT/report.html after a group, unless the last page is fresh enough.

    Args:
        out: Output folder of the run.
        present: Hook to call first.
        progress: Display for a page that cannot be written.
        clock: Seconds since any moment.
    """

    def __init__(
        self, out: Path, present: PresentationHook, progress: Progress, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._out = out
        self._present = present
        self._progress = progress
        self._clock = clock
        self._next = 0.0
        self._failed = False

    def __call__(self, writer: ReelWriter, group: int | None) -> None:
        """Write what changed of the presentation, then the page."""
        self._present(writer, group)
        if group is not None and self._clock() >= self._next:
            self._write("none")

    def finish(self) -> None:
        """Write the page of the finished reel, with its player."""
        if (self._out / "reel" / "manifest.json").is_file():
            self._write("embedded")

    def _write(self, player: Player) -> None:
        """Write the page. A run does not fail because of its page."""
        begun = self._clock()
        try:
            write_report_page(self._out, self._out / "reel", player)
        except (SplatreelError, OSError) as error:
            if not self._failed:
                self._progress.note(f"{self._out / 'report.html'} cannot be written ({error}).")
            self._failed = True
        now = self._clock()
        self._next = now + max(LEAST_SECONDS, (now - begun) / _LARGEST_SHARE)


SECONDS = 10.0
"""Seconds between two updates of the page. The player keeps playing."""


class ServedReport:
    """Report page that is made anew when a file of the run has changed. Thread-safe.

    Args:
        out: Output folder of the run, with report.json and images.
        reel: Folder of the reel.

    Attributes:
        policy: Content-Security-Policy of the page.
    """

    def __init__(self, out: Path, reel: Path) -> None:
        self._out = out
        self._reel = reel
        self._lock = threading.Lock()
        self._seen: list[tuple[str, int, int]] | None = None
        self._text = ""
        self.policy = refreshed_policy(SECONDS)

    def read(self) -> str:
        """Return the page as HTML.

        Raises:
            ReelError: There is no reel.
        """
        with self._lock:
            seen = self._state()
            if seen != self._seen:
                page = report_page(RunFacts.read(self._out, self._reel), "beside")
                self._text = refreshed(page, SECONDS)
                self._seen = seen
            return self._text

    def _state(self) -> list[tuple[str, int, int]]:
        files = [self._out / "report.json", self._reel / "manifest.json", *self._out.glob("pictures/*/*.png")]
        files += sorted((self._out / "work" / LOGS).glob("history*.jsonl"))
        found = [(str(path), path.stat()) for path in files if path.is_file()]
        return [(path, status.st_mtime_ns, status.st_size) for path, status in found]
