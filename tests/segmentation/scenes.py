"""Scenes with known masks: a body of spheres that walks over a floor, before static images, with a shadow on the floor."""

import json
import math
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from splatreel.scene.camera import Camera, facing

WIDTH, HEIGHT, CAMERAS = 96, 72, 6
SPHERES = (
    ((0.0, 0.35, 0.0), 0.35, (200, 40, 40)),
    ((0.0, 0.85, 0.0), 0.28, (30, 60, 190)),
    ((0.0, 1.3, 0.0), 0.2, (230, 190, 60)),
)
"""Center, radius and color of the spheres of a body."""
SHADOW = 0.75


def ring(count: int = CAMERAS) -> list[Camera]:
    """Return cameras around the scene that look at its middle."""
    views = []
    for k in range(count):
        angle = 2 * math.pi * k / count
        center = np.array([4 * math.sin(angle), 1.4 + 0.3 * (k % 2), 4 * math.cos(angle)])
        forward = np.array([0, 0.6, 0]) - center
        views.append(facing(f"c{k}", center, forward / np.linalg.norm(forward), 0.8 * WIDTH, WIDTH, HEIGHT))
    return views


def backdrop(number: int) -> np.ndarray:
    """Return the static image behind everything, [H, W, 3] uint8, smooth and in middle gray levels."""
    noise = np.random.default_rng(number).uniform(90, 190, (6, 8, 3)).astype(np.float32)
    return cv2.resize(noise, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC).clip(60, 220).astype(np.uint8)


def walk(frame: int) -> tuple[float, float]:
    """Return where the body stands."""
    return 0.9 * math.sin(0.35 * frame), 0.9 * math.cos(0.35 * frame)


def shoot(
    view: Camera, number: int, frame: int, at: tuple[float, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the image [H, W, 3] uint8 and the mask [H, W] bool of a camera at a frame."""
    image, mask = backdrop(number).astype(np.float32), np.zeros((HEIGHT, WIDTH), np.uint8)
    x, z = walk(frame) if at is None else at
    circle = [(x + 0.6 + 0.45 * math.cos(a), 0.0, z + 0.45 * math.sin(a)) for a in np.linspace(0, 2 * math.pi, 24)]
    shade = np.zeros((HEIGHT, WIDTH), np.float32)
    cv2.fillPoly(shade, [np.stack([project(view, point)[0] for point in circle]).round().astype(np.int32)], 1.0)
    image *= 1 - (1 - SHADOW) * cv2.GaussianBlur(shade, (0, 0), 2)[..., None]
    for center, radius, color in SPHERES:
        pixel, depth = project(view, (center[0] + x, center[1], center[2] + z))
        place = tuple(int(v) for v in pixel.round())
        cv2.circle(image, place, round(radius * float(view.K[0, 0]) / depth), color, -1)
        cv2.circle(mask, place, round(radius * float(view.K[0, 0]) / depth), 1, -1)
    noise = np.random.default_rng(1000 * number + frame).normal(0, 1.5, image.shape)
    return (image + noise).clip(0, 255).astype(np.uint8), mask > 0


def project(view: Camera, point: tuple[float, float, float]) -> tuple[np.ndarray, float]:
    """Return the pixel of a point and its depth."""
    seen = view.viewmat[:3, :3] @ np.array(point) + view.viewmat[:3, 3]
    return (view.K @ seen / seen[2])[:2], float(seen[2])


def film(frames: int, count: int = CAMERAS, at: tuple[float, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return images [T, C, H, W, 3] uint8 and masks [T, C, H, W] bool. `at`: the body stays there."""
    shots = [[shoot(view, c, t, at) for c, view in enumerate(ring(count))] for t in range(frames)]
    return np.stack([[image for image, _ in row] for row in shots]), np.stack(
        [[mask for _, mask in row] for row in shots]
    )


def overlap(found: np.ndarray, truth: np.ndarray) -> float:
    """Return the intersection of masks over their union."""
    return float((found & truth).sum() / max((found | truth).sum(), 1))


def write_capture(folder: Path, frames: int, at: tuple[float, float] | None = None) -> Path:
    """Write a scene as Panoptic captures are."""
    images, _ = film(frames, at=at)
    views = ring()
    names = list(range(1, len(views) + 1))
    for c, name in enumerate(names):
        (folder / "ims" / str(name)).mkdir(parents=True)
        for t in range(frames):
            Image.fromarray(images[t, c]).save(folder / "ims" / str(name) / f"{t:06d}.png")
    meta = {
        "w": WIDTH,
        "h": HEIGHT,
        "k": [[view.K.tolist() for view in views]] * frames,
        "w2c": [[view.viewmat.tolist() for view in views]] * frames,
        "fn": [[f"{name}/{t:06d}.png" for name in names] for t in range(frames)],
        "cam_id": [names] * frames,
    }
    (folder / "train_meta.json").write_text(json.dumps(meta))
    return folder
