"""Reconstruct a subject from a few cameras of a capture, and measure it in the cameras that were not chosen, by their angle.

python benchmarks/few_cameras.py CAPTURE MASKS --compared 18,22,28,25 --chosen 1,7,20,29,27,16 8,12,9,24,19,17
python benchmarks/few_cameras.py CAPTURE MASKS --compared 18,22,28,25          # ceiling: all cameras but the compared ones
python benchmarks/few_cameras.py CAPTURE OWN --within MASKS ...                # trains on OWN, measures within MASKS

The table of basketball, with four, six and eight cameras, given and automatic masks:

python benchmarks/few_cameras.py CAPTURE MASKS --compared 18,22,28,25 --automatic --quality standard \\
    --chosen 3,29,14,26 1,7,20,29,27,16 8,12,9,24,19,17 9,29,5,14,19,7,8,24

After an interruption the same command continues. It skips rows that the results have for the same source. Each row has its folder
below OUT, with the reel, the report and a sheet of the subject from eight sides.
"""

import json
import shutil
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from tyro.conf import Positional

from record import RESULTS, record, source
from splatreel.base.display import console
from splatreel.capture.masks import MADE_MASKS
from splatreel.capture.opening import CaptureSource, open_capture
from splatreel.cli.capture_masks import make_masks
from splatreel.cli.options import parse_frames
from splatreel.config import Quality, preset
from splatreel.config.settings import changed
from splatreel.evaluation.evaluate import evaluate
from splatreel.evaluation.reel_capture import open_reel_capture
from splatreel.method.images.people import find_people
from splatreel.play.timeline import open_reel
from splatreel.run.pipeline import reconstruct
from turntable import first_middle_last, write_sheet

METRICS = ("psnr", "ssim", "lpips")
Masks = Literal["given", "automatic", "automatic, networks"]
"""Masks of the user, or those of `capture masks`, with or without networks of people."""


@dataclass(frozen=True)
class Row:
    """One measured reconstruction.

    Attributes:
        capture: Name of the capture.
        cameras: Names of the cameras to train on.
        masks: The masks that it is trained on.
        span: Frames A to B - 1, as A:B.
        not_trained: Names of the cameras that are compared.
    """

    capture: str
    cameras: list[str]
    masks: Masks
    quality: Quality
    width: int
    span: str
    seed: int
    not_trained: list[str]

    @property
    def name(self) -> str:
        """Name of its folder."""
        masks, cameras, span = self.masks.replace(", ", "-"), "-".join(self.cameras), self.span.replace(":", "-")
        return f"{self.capture}-{masks}-{cameras}-{self.width}-{self.quality}-{span}-{self.seed}"


def main(
    capture: Positional[Path],
    masks: Positional[Path],
    /,
    compared: str,
    chosen: tuple[str, ...] = (),
    automatic: bool = False,
    width: int = 320,
    frames: str = "0:6",
    quality: Quality = "draft",
    within: Path | None = None,
    seed: int = 0,
    out: Path = Path("out/few-cameras"),
    results: Path = RESULTS,
    note: str = "",
) -> None:
    """Reconstruct, evaluate within the masks, record.

    Args:
        capture: The capture.
        masks: Folder of masks of the chosen cameras, and of the compared ones without --within.
        compared: Names of the cameras to compare with, as NAME,NAME. They are not trained on.
        chosen: Sets of cameras to train on, NAME,NAME each; by default one of all with masks that are not compared.
        automatic: Adds a row for each set that trains on masks that `capture masks` makes from the images of the set.
        width: Width of the images in pixels.
        frames: Frames A to B - 1, as A:B.
        quality: Preset of settings.
        within: Folder of masks of the compared cameras. In a folder with doubts, gray pixels of their borders would not count.
        seed: Seed of all random numbers.
        out: Output folder.
        results: File that the rows are appended to.
        note: Note of the records.
    """
    others = compared.split(",")
    with closing(open_capture(capture, width=width)) as everything:
        names = [camera.name for camera in everything.cameras]
    with_masks = [name for name in names if (masks / name).exists()]
    sets = [one.split(",") for one in chosen] or [[name for name in with_masks if name not in others]]
    if both := sorted({name for one in sets for name in one} & set(others)):
        raise SystemExit(f"{', '.join(both)}: cannot be both trained on and compared. Change --chosen or --compared.")
    called = capture.name if capture.name != "capture" else capture.parent.name  # films are in FILM/capture
    kinds: list[Masks] = ["given"]
    if automatic:
        kinds.append("automatic, networks" if find_people() else "automatic")
    rows = [Row(called, one, kind, quality, width, frames, seed, others) for one in sets for kind in kinds]

    def measure_row(row: Row) -> dict[str, Any]:
        return measure(row, capture, masks, within or masks, [n for n in names if n not in row.cameras], out)

    run_table(rows, measure_row, results, note)


def run_table(rows: list[Row], measured: Callable[[Row], dict[str, Any]], results: Path, note: str) -> None:
    """Measure and record the rows that the results do not have, and print all."""
    for row in rows:
        found = recorded(row, results, note)
        if found is None:
            found = record("few cameras", asdict(row) | {"source": source()} | measured(row), note, results)
        print(described(found), flush=True)


def recorded(row: Row, results: Path, note: str) -> dict[str, Any] | None:
    """Return the record of a row for this source, which has no changes, with this note; None if there is none."""
    same = asdict(row) | {"benchmark": "few cameras", "note": note, "source": source()}
    if same["source"].endswith("+") or not results.exists():
        return None
    lines = [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]
    return next((line for line in lines if all(line.get(name) == value for name, value in same.items())), None)


def measure(row: Row, capture: Path, masks: Path, within: Path, unread: list[str], out: Path) -> dict[str, Any]:
    """Reconstruct and evaluate a row in its own folder, and draw its sheet.

    Args:
        row: The row.
        capture: The capture.
        masks: Folder of given masks of its cameras.
        within: Folder of masks of the compared cameras.
        unread: Names of the cameras that are not read for training.
        out: Folder of the folders of all rows.
    """
    revision = source()
    folder = out / revision / row.name
    if revision.endswith("+"):
        shutil.rmtree(folder, ignore_errors=True)  # it may be of other changes
    request = {"frames": parse_frames(row.span), "held_out": [], "leave_out": unread}
    if row.masks != "given":
        masks = folder / MADE_MASKS
        make_masks(CaptureSource(capture, request), masks, None)
    config = changed(preset(row.quality), {"seed": row.seed, "check_coverage": False})  # its trial changes no points
    with (
        closing(open_capture(capture, width=row.width, masks=masks, **request)) as trained,
        closing(console()) as shown,
    ):
        reel = reconstruct(trained, folder, config, progress=shown).reel
    whole, frames = open_reel_capture(reel, capture, width=row.width, masks=within, names=row.not_trained)
    with closing(whole):
        report = evaluate(reel, whole, cameras=row.not_trained, frames=frames, out=folder)
    timeline = open_reel(reel)
    write_sheet(timeline, first_middle_last(len(timeline)), folder / "turntable.png")
    return {
        "frames": report.frames,
        "bytes": report.reel_bytes,
        **{name: getattr(report, name) for name in METRICS},
        "compared": [{name: camera[name] for name in ("name", "degrees", *METRICS)} for camera in report.cameras],
    }


def described(found: dict[str, Any]) -> str:
    """Return a record as lines: the means, then each compared camera with its angle to the nearest training camera."""
    title = (
        f"{len(found['cameras'])} cameras ({','.join(found['cameras'])}), {found['masks']} masks, {found['quality']}"
    )
    lines = [f"{title}: {_metrics(found)}, {found['bytes'] / 1000:.1f} kB"]
    for camera in sorted(found["compared"], key=lambda camera: (camera["degrees"] or 0.0, camera["name"])):
        angle = "" if camera["degrees"] is None else f" at {camera['degrees']:.0f} degrees"
        lines.append(f"  {camera['name']}{angle}: {_metrics(camera)}")
    return "\n".join(lines)


def _metrics(found: dict[str, Any]) -> str:
    perceived = "" if found["lpips"] is None else f", LPIPS {found['lpips']:.3f}"
    return f"{found['psnr']:.2f} dB, SSIM {found['ssim']:.3f}{perceived}"


if __name__ == "__main__":
    tyro.cli(main)
