"""Compare the opacities of border pixels with the exact ones of the built-in capture's moving toys, and record their errors.

The masks are the exact ones, whose pixels are white where toys fill at least half of them, and the same wider and narrower by a pixel.

python benchmarks/border_opacity.py
"""

import cv2
import numpy as np
import tyro

from film import FPS
from record import record
from splatreel.capture.masks import opacity_of_level
from splatreel.segmentation.background import MIN_NOISE, Background
from splatreel.segmentation.borders import with_border_opacity
from splatreel.segmentation.evidence import MIN_FLOOR
from toyroom import room as toys
from toyroom.capture import make_cameras
from toyroom.raytracer import trace_cover, trace_frame, trace_static
from toyroom.solids import Shapes

CROSS, SQUARE = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)), np.ones((3, 3), np.uint8)
KINDS = {
    "exact": lambda mask: mask,
    "wider": lambda mask: cv2.dilate(mask, CROSS),
    "narrower": lambda mask: cv2.erode(mask, CROSS),
}


def main(frames: tuple[int, ...] = (21, 25, 29), every: int = 3, note: str = "") -> None:
    """Trace, estimate, compare, record.

    Args:
        frames: Frames of the film.
        every: Each how many-th camera is compared.
        note: Note of the record.
    """
    errors: dict[str, list[np.ndarray]] = {f"{kind}_{what}": [] for kind in KINDS for what in ("mask", "opacity")}
    still = toys.standing(0)
    for camera in make_cameras()[::every]:
        seen = trace_static(camera, still, toys.LIGHT)
        moving = toys.moving(0)
        empty = Shapes(moving.solids[:0], moving.bodies[:0])
        plate = trace_frame(camera, seen, still, empty, toys.LIGHT).astype(np.float32)
        one = np.ones(plate.shape[:2], np.float32)
        background = Background(plate, MIN_NOISE * one, one, one > 0, MIN_FLOOR)
        for frame in frames:
            moving = toys.moving(frame / FPS)
            cover, _ = trace_cover(camera, seen, moving, np.ones(len(moving.solids), bool))
            image = trace_frame(camera, seen, still, moving, toys.LIGHT)
            exact = (cover >= 0.5).astype(np.uint8)
            border = cv2.dilate(exact, SQUARE) != cv2.erode(exact, SQUARE)
            for kind, changed in KINDS.items():
                mask = changed(exact)
                opacity = opacity_of_level(with_border_opacity(mask * np.uint8(255), image, background)) / 255
                errors[f"{kind}_mask"].append(np.abs(mask - cover)[border])
                errors[f"{kind}_opacity"].append(np.abs(opacity - cover)[border])
    values = {name: float(np.concatenate(found).mean()) for name, found in errors.items()}
    print(record("border opacity", {"frames": len(frames), "every": every, **values}, note))


if __name__ == "__main__":
    tyro.cli(main)
