"""Reconstruct a subject from a few cameras of a capture, and measure it in the cameras that were not chosen, by their angle.

python benchmarks/few_cameras.py CAPTURE MASKS --chosen 1,7,20,29,27,16 --compared 18,22,28,25 --width 320
python benchmarks/few_cameras.py CAPTURE MASKS --compared 18,22,28,25          # ceiling: all cameras but the compared ones
python benchmarks/few_cameras.py CAPTURE OWN --within MASKS ...                # trains on OWN, measures within MASKS
"""

from pathlib import Path

import numpy as np
import tyro
from tyro.conf import Positional

from record import record
from splatreel.base.display import console
from splatreel.capture.opening import open_capture
from splatreel.cli.options import parse_frames
from splatreel.config import Quality, preset
from splatreel.config.settings import changed
from splatreel.evaluation.evaluate import evaluate
from splatreel.evaluation.reel_capture import open_reel_capture
from splatreel.run.pipeline import reconstruct

METRICS = ("psnr", "ssim", "lpips")


def main(
    capture: Positional[Path],
    masks: Positional[Path],
    /,
    compared: str,
    chosen: str | None = None,
    width: int = 320,
    frames: str = "0:6",
    quality: Quality = "draft",
    within: Path | None = None,
    seed: int = 0,
    out: Path | None = None,
    note: str = "",
) -> None:
    """Reconstruct, evaluate within the masks, record.

    Args:
        capture: The capture.
        masks: Folder of masks of the chosen cameras, and of the compared ones without --within.
        compared: Names of the cameras to compare with, as NAME,NAME. They are not trained on.
        chosen: Names of the cameras to train on; by default all with masks that are not compared.
        width: Width of the images in pixels.
        frames: Frames A to B - 1, as A:B.
        quality: Preset of settings.
        within: Folder of masks of the compared cameras. In a folder with doubts, gray pixels of their borders would not count.
        seed: Seed of all random numbers.
        out: Output folder.
        note: Note of the record.
    """
    others = compared.split(",")
    everything = open_capture(capture, width=width)
    names = [camera.name for camera in everything.cameras]
    everything.close()
    with_masks = [name for name in names if (masks / name).exists()]
    training = chosen.split(",") if chosen else [name for name in with_masks if name not in others]
    if both := sorted(set(training) & set(others)):
        raise SystemExit(f"{', '.join(both)}: cannot be both trained on and compared. Change --chosen or --compared.")
    out = out or Path(f"out/few-{capture.name}-{len(training)}-{width}-{quality}-{seed}")
    source = open_capture(
        capture,
        width=width,
        frames=parse_frames(frames),
        held_out=[],
        leave_out=[name for name in names if name not in training],
        masks=masks,
    )
    reel = reconstruct(source, out, changed(preset(quality), {"seed": seed}), progress=console()).reel
    source.close()
    whole, shown = open_reel_capture(reel, capture, width=width, masks=within or masks, names=others)
    report = evaluate(reel, whole, cameras=others, frames=shown, out=out)
    whole.close()
    values = {
        "capture": capture.name if capture.name != "capture" else capture.parent.name,  # films are in FILM/capture
        "cameras": training,
        "quality": quality,
        "frames": report.frames,
        "width": report.width,
        "bytes": report.reel_bytes,
        "psnr": report.psnr,
        "ssim": report.ssim,
        "lpips": report.lpips,
        "by_angle": by_angle(report.cameras),
    }
    print(record("few cameras", values, note))


def by_angle(cameras: list[dict]) -> list[dict]:
    """Return the metrics of cameras that are equally far from the nearest training camera, to five degrees, nearest first."""
    groups: dict[int, list[dict]] = {}
    for camera in cameras:
        groups.setdefault(5 * round(camera["degrees"] / 5), []).append(camera)
    found = []
    for degrees, members in sorted(groups.items()):
        means = {name: float(np.mean([m[name] for m in members])) for name in METRICS if members[0][name] is not None}
        found.append({"degrees": degrees, "cameras": [m["name"] for m in members], **means})
    return found


if __name__ == "__main__":
    tyro.cli(main)
