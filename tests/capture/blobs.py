"""A rig and points whose images are drawn by the formulas of a format, and found again in what a reader returns."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from splatreel.capture.base import Capture

WIDTH, HEIGHT = 160, 120
POINTS = np.array([[0, 0, 0], [0.6, 0.1, 0.2], [-0.5, 0.4, 0], [0.1, -0.5, 0.3], [-0.4, -0.4, -0.2], [0.45, 0.45, 0.1]])
SPREAD = 2.0
"""Standard deviation of a drawn point in pixels."""
FOCAL = 150.0
BENDS = (-0.2, 0.06, 0.004, -0.003, 0.01)
"""Distortion in OpenCV's order, strong enough to move points by several pixels."""


def poses(count: int = 4) -> list[tuple[np.ndarray, np.ndarray]]:
    """World to camera in OpenCV's axes, R and t, on an arc around the points."""
    made = []
    for c in range(count):
        angle, roll = 0.4 * (c - count / 2) + 0.1, 0.15 * c - 0.2
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        lean = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
        made.append((lean @ turn, np.array([0.1 * c - 0.1, -0.05 * c, 3.0 + 0.1 * c])))
    return made


def draw(pixels: np.ndarray, first: float, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """Draw points in three colors in turn. `first` is the coordinate of the first pixel's center."""
    y, x = np.mgrid[:height, :width] + first
    image = np.zeros((height, width, 3))
    for number, (u, v) in enumerate(pixels):
        image[..., number % 3] += 230 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * SPREAD**2))
    return image.clip(0, 255).round().astype(np.uint8)


def save(folder: Path, name: str, image: np.ndarray) -> None:
    """Write the image of a camera's only frame."""
    (folder / name).mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(folder / name / "000000.png")


def write(folder: Path, names: list[str], project: Callable[[int], np.ndarray], first: float) -> None:
    """Write the images that the projection of each camera shows, [P, 2] pixels."""
    for c, name in enumerate(names):
        save(folder, name, draw(project(c), first))


def errors(capture: Capture) -> np.ndarray:
    """Return the distances in pixels between points in the images and where the cameras project them, [C, P]."""
    found = []
    for camera in capture.cameras:
        image = capture.read(0, 1, [camera.name])[0, 0].astype(float)
        for number, point in enumerate(POINTS):
            x, y, z = camera.K @ (camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3])
            found.append(np.hypot(*(_centroid(image[..., number % 3], x / z, y / z) - (x / z, y / z))))
    return np.array(found).reshape(len(capture.cameras), len(POINTS))


def _centroid(channel: np.ndarray, x: float, y: float) -> np.ndarray:
    """Return the center of the light around a place; pixel centers are at +0.5."""
    reach = 7
    left, top = int(x) - reach, int(y) - reach
    part = channel[max(top, 0) : top + 2 * reach + 2, max(left, 0) : left + 2 * reach + 2]
    rows, columns = np.mgrid[: part.shape[0], : part.shape[1]] + 0.5
    light = part.sum()
    assert light > 100, f"no point near {x:.1f}, {y:.1f}"
    return np.array([(columns * part).sum() / light + max(left, 0), (rows * part).sum() / light + max(top, 0)])
