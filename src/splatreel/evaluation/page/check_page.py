"""The page of `splatreel capture check`: verdict, cameras with their matches, synchronization, and an image of each camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from splatreel.capture.base import Capture
from splatreel.capture.masks import LIKELY
from splatreel.capture.sidecar import read_sidecar
from splatreel.evaluation.page.html import escape, html_list, html_page, html_table, jpeg_url, section
from splatreel.evaluation.page.rig_plan import RigPlan, rig_drawings
from splatreel.method.init.layout import upright
from splatreel.method.prediction.quality import Coverage

_THUMBNAIL = 320
"""Longer side of a camera's image, in pixels."""
_BRIGHTNESS = 0.25
"""Smallest difference from the median brightness of all cameras, as a share, for which a camera is named."""
MANY, FAINTEST = 100, 0.06
"""Number of points in common at which a line is fully visible, and the opacity of the faintest line."""
_LINES = 2
"""Number of lines from a camera, to those with the most points in common. Lines of all pairs would be a tangle."""
_WEAKEST = 3
"""Number of cameras that are named as those with the fewest points in common."""
DIMMED = 0.2
"""Brightness of the surroundings of a masked subject, as a share."""
_PARTNERS = 3
"""Number of cameras that a row names as those with the most points in common."""


@dataclass(frozen=True)
class CheckFacts:
    """Facts of a check.

    Attributes:
        images: Images of all cameras at one moment, uint8 [C, H, W, 3], in the order of `capture.cameras`.
        sentences: Notes and doubts that were printed.
        verdict: Closing lines that were printed.
        coverage: Coverage by the training cameras; None if it was not measured.
        masks: Masks of the images, uint8 [C, H, W]; None without masks.
    """

    capture: Capture
    images: np.ndarray
    sentences: Sequence[str]
    verdict: str
    coverage: Coverage | None
    masks: np.ndarray | None = None


def check_page(facts: CheckFacts) -> str:
    """Return the page as HTML."""
    capture = facts.capture
    size = f"{capture.width} x {capture.height} pixels"
    subtitle = f"{len(capture.cameras)} cameras, {capture.frames} frames at {capture.fps:g} per second, {size}."
    levels = facts.images.mean((1, 2, 3))
    sections = [
        section("Verdict", html_list(map(_verdict_line, facts.verdict.split("\n"))), "findings"),
        section("Notes", html_list([*facts.sentences, *_weakest(facts.coverage), *_uneven_exposures(facts, levels)])),
        section("Cameras", _rig(facts)),
        section("Coverage and exposure", _table(facts, levels)),
        section("Synchronization", _synchronization(capture)),
        section("Masks", _mask_sheet(facts)),
        section("Pictures", _contact_sheet(facts)),
    ]
    return html_page(f"Check: {capture.path.name}", capture.path.name, subtitle, sections)


def _verdict_line(line: str) -> str:
    """Return a line of the verdict without its indentation, commands as code."""
    return f"`{line.strip()}`" if line.startswith("  splatreel") else line.strip().removeprefix("- ")


def _rig(facts: CheckFacts) -> str:
    capture = facts.capture
    held_out = [camera for camera in capture.cameras if camera.name in capture.held_out]
    points = np.zeros((0, 3)) if capture.points is None else capture.points
    return rig_drawings(RigPlan(capture.training_cameras, held_out, upright(capture.cameras), points, _links(facts)))


def _links(facts: CheckFacts) -> list[tuple[int, int, float]]:
    """Return lines from each training camera to its best partners. A line with `MANY` points in common is fully visible."""
    if facts.coverage is None or facts.coverage.pairs is None:
        return []
    training = [camera.name for camera in facts.capture.training_cameras]
    numbers = [training.index(name) for name in facts.coverage.names]
    best = {
        (min(camera, other), max(camera, other)): count
        for camera in range(len(numbers))
        for other, count in _partners(facts.coverage, camera)[:_LINES]
    }
    return [(numbers[a], numbers[b], max(min(count / MANY, 1.0), FAINTEST)) for (a, b), count in best.items()]


def _partners(coverage: Coverage, camera: int) -> list[tuple[int, int]]:
    """Return the numbers of the cameras with which one has the most points in common, and the numbers of these points."""
    if coverage.pairs is None:
        return []
    counts = np.array(coverage.pairs[camera])
    counts[camera] = 0
    best = np.argsort(-counts, kind="stable")[:_PARTNERS]
    return [(int(other), int(counts[other])) for other in best if counts[other]]


def _weakest(coverage: Coverage | None) -> list[str]:
    """Return a sentence that names the cameras with the fewest points in common with others."""
    if coverage is None or len(coverage.names) <= _WEAKEST:
        return []
    order = np.argsort(coverage.shared, kind="stable")[:_WEAKEST]
    named = ", ".join(f"{coverage.names[c]} ({coverage.shared[c]:,})" for c in order)
    return [f"the cameras with the fewest points in common with others: {named}"]


def _named_partners(coverage: Coverage, camera: int) -> str:
    if coverage.pairs is None:
        return ""
    return ", ".join(f"{coverage.names[other]} {count:,}" for other, count in _partners(coverage, camera)) or "none"


def _synchronization(capture: Capture) -> str:
    """Return a table of start times and how certain they are; nothing without start times."""
    sidecar = read_sidecar(capture.path)
    rows = []
    for name, start in sorted(sidecar.starts.items()):
        found = sidecar.sync.get(name)
        certain = (
            "" if found is None or found.clear is None else f"{found.clear:.1f} times ({found.needed:.1f} is needed)"
        )
        shown = f"{start:.3f}"
        if (rate := sidecar.rates.get(name, 1.0)) != 1:
            shown += f", then {rate:.5f} a second"
        rows.append((name, shown, "" if found is None else found.other, "" if found is None else found.by, certain))
    heads = ("Camera", "Seconds at the start", "Aligned with", "By", "Better than at any other time by")
    return html_table(heads, rows, "counts") if rows else ""


def _uneven_exposures(facts: CheckFacts, levels: np.ndarray) -> list[str]:
    """Return a sentence about cameras of another brightness. `levels` [C]: mean gray level of each camera."""
    typical = max(float(np.median(levels)), 1.0)
    named = [
        camera.name
        for camera, level in zip(facts.capture.cameras, levels, strict=True)
        if abs(level / typical - 1) > _BRIGHTNESS
    ]
    if not named:
        return []
    return [f"brighter or darker than most cameras by {_BRIGHTNESS:.0%} or more: {', '.join(named)}"]


def _table(facts: CheckFacts, levels: np.ndarray) -> str:
    known = {}
    if (coverage := facts.coverage) is not None:
        known = {
            name: (f"{coverage.angles[c]:.1f}", f"{coverage.shared[c]:,}", _named_partners(coverage, c))
            for c, name in enumerate(coverage.names)
        }
    rows = []
    for camera, level in zip(facts.capture.cameras, levels, strict=True):
        use = "held out" if camera.name in facts.capture.held_out else "training"
        rows.append((camera.name, use, *known.get(camera.name, ("", "", "")), f"{level:.0f}"))
    heads = ("Camera", "Use", "Degrees to the nearest", "Points in common", "Most in common with", "Mean gray level")
    return html_table(heads, rows, "counts")


def _mask_sheet(facts: CheckFacts) -> str:
    """Return the subject of each camera with dimmed surroundings, and its share of the image; nothing without masks."""
    if facts.masks is None:
        return ""
    figures = []
    for camera, image, mask in zip(facts.capture.cameras, facts.images, facts.masks, strict=True):
        weight = DIMMED + (1 - DIMMED) * (mask[..., None] / 255)
        shown = Image.fromarray((image * weight).astype(np.uint8))
        figures.append(_figure(shown, camera.name, "Mask", f"{camera.name}: {(mask > LIKELY).mean():.1%}"))
    return f'<div class="strip">{"".join(figures)}</div>'


def _figure(image: Image.Image, name: str, kind: str, caption: str) -> str:
    url = jpeg_url(image, _THUMBNAIL)
    return (
        f'<figure><img src="{url}" alt="{kind} of {escape(name)}"><figcaption>{escape(caption)}</figcaption></figure>'
    )


def _contact_sheet(facts: CheckFacts) -> str:
    figures = [
        _figure(Image.fromarray(image), camera.name, "Picture", camera.name)
        for camera, image in zip(facts.capture.cameras, facts.images, strict=True)
    ]
    return f'<div class="strip">{"".join(figures)}</div>'
