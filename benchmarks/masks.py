"""Compare the masks of `capture masks` with masks of the same images, and record their intersection over union.

Small parts of the given masks that do not touch the border of the image, such as blobs beside feet, are not counted.

python benchmarks/masks.py CAPTURE MASKS --cameras 1,7,20,29,27,16 --every 6
"""

import time
from pathlib import Path

import cv2
import numpy as np
import tyro
from tyro.conf import Positional

from record import record
from splatreel.capture.images import read_image
from splatreel.capture.opening import open_capture
from splatreel.method.images.people import find_people
from splatreel.segmentation.mask_writer import sample_moments
from splatreel.segmentation.segmenter import fit_subject

BLOB = 0.0025
"""Area of the largest part of a mask that is not counted, as a share of the image."""


def main(
    capture: Positional[Path],
    masks: Positional[Path],
    cameras: str | None = None,
    frames: tuple[int, int] = (0, 60),
    every: int = 6,
    width: int = 320,
    overlays: Path | None = None,
    people: bool = True,
    note: str = "",
) -> None:
    """Segment every EVERYth frame, and compare the cameras that have given masks.

    Args:
        capture: The capture.
        masks: Folder with a folder of images for each camera.
        cameras: Names of the cameras to read, as NAME,NAME; by default all with masks.
        frames: First frame and end.
        every: Distance of the frames to compare.
        width: Width of the images in pixels.
        overlays: Image to write: red where only the new mask is white, blue where only the given one is.
        people: Networks of people complete the masks.
        note: Note of the record.
    """
    with_masks = {path.name for path in masks.iterdir() if path.is_dir()}
    everything = open_capture(capture, width=width)
    names = [camera.name for camera in everything.cameras]
    chosen = cameras.split(",") if cameras else [name for name in names if name in with_masks]
    everything.close()
    source = open_capture(
        capture, width=width, frames=frames, held_out=[], leave_out=[n for n in names if n not in chosen]
    )
    names = [camera.name for camera in source.cameras]
    begun = time.process_time()
    samples = np.stack([source.read(t, 1, names)[0] for t in sample_moments(source.frames)])
    model = fit_subject(source.cameras, samples, near=source.near or 0, people=find_people() if people else None)
    fitted = time.process_time()
    counts = {name: np.zeros(2) for name in names}
    rows, compared = [], range(1, source.frames - 1, every)
    for t in compared:
        images = source.read(t - 1, 3, names)
        found = model.masks(images)[1] > 127
        for c, name in enumerate(names):
            file = sorted((masks / name).iterdir())[frames[0] + t]
            given = read_image(file, source.width, source.height, mask=True)[..., 1] > 127
            counted = ~blobs(given)
            counts[name] += (found[c] & given & counted).sum(), ((found[c] | given) & counted).sum()
            overlay = images[1, c].copy()
            overlay[found[c] & ~given] = 255, 0, 0
            overlay[given & ~found[c]] = 0, 0, 255
            rows.append(overlay)
    source.close()
    if overlays is not None:
        rows += [np.zeros_like(rows[0])] * (-len(rows) % 6)
        sheet = np.concatenate([np.concatenate(rows[i : i + 6], 1) for i in range(0, len(rows), 6)])
        cv2.imwrite(str(overlays), sheet[..., ::-1])
    by_camera = {name: float(inside / union) for name, (inside, union) in counts.items() if union}
    values = {
        "capture": capture.name,
        "cameras": len(names),
        "frames": len(compared),
        "width": width,
        "people": people,
        "iou": float(np.mean(list(by_camera.values()))),
        "iou_by_camera": by_camera,
        "fit_cpu_seconds": fitted - begun,
        "image_cpu_seconds": (time.process_time() - fitted) / max(3 * len(compared) * len(names), 1),
    }
    print(record("masks", values, note))


def blobs(mask: np.ndarray) -> np.ndarray:
    """Return the pixels around small parts of a mask [H, W] bool that do not touch the border of the image."""
    count, parts, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    height, width = mask.shape
    small = [
        k
        for k in range(1, count)
        if stats[k, 4] < BLOB * mask.size
        and stats[k, 0] > 0
        and stats[k, 1] > 0
        and stats[k, 0] + stats[k, 2] < width
        and stats[k, 1] + stats[k, 3] < height
    ]
    return cv2.dilate(np.isin(parts, small).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


if __name__ == "__main__":
    tyro.cli(main)
