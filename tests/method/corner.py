"""A textured corner of a room, and cameras that look at it: a scene that has features, and of which every depth is known."""

import cv2
import numpy as np

from splatreel.method.init import planesweep
from splatreel.scene.camera import Camera

WIDTH, HEIGHT = 192, 128
FLOOR, WALL = 1.0, 6.0


def arc(count: int = 5) -> list[Camera]:
    """Cameras side by side that look along +z at a corner made of a floor at y = 1 and a wall at z = 6."""
    K = np.array([[170, 0, WIDTH / 2], [0, 170, HEIGHT / 2], [0, 0, 1]])
    cameras = []
    for i, x in enumerate(np.linspace(-0.6, 0.6, count)):
        angle = x * 0.15  # turned towards the middle
        R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        viewmat = np.eye(4)
        viewmat[:3, :3] = R
        viewmat[:3, 3] = -R @ [x, 0.1 * (-1) ** i, 0]
        cameras.append(Camera(f"cam{i}", viewmat, K, WIDTH, HEIGHT))
    return cameras


def texture(seed: int) -> np.ndarray:
    """Smooth color noise that has features at several sizes, [512, 512, 3] float32 0..255."""
    rng = np.random.default_rng(seed)
    layers = [cv2.resize(rng.random((n, n, 3)).astype(np.float32), (512, 512)) for n in (16, 64, 160)]
    total = np.sum(layers, axis=0)
    return 255 * (total - total.min()) / (total.max() - total.min())


def depth_of(camera: Camera) -> np.ndarray:
    """The true depth along the camera's axis, [H, W]."""
    rays = planesweep.unproject(camera, np.ones((HEIGHT, WIDTH))) - camera.center
    to_wall = (WALL - camera.center[2]) / rays[..., 2]
    with np.errstate(divide="ignore"):
        to_floor = (FLOOR - camera.center[1]) / rays[..., 1]
    return np.where((to_floor > 0) & (to_floor < to_wall), to_floor, to_wall)


def make_image(camera: Camera, bare: float = 0) -> np.ndarray:
    """The corner, textured but for a strip of the floor where |x| < bare, as the camera sees it; [H, W, 3] uint8."""
    depth = depth_of(camera)
    points = planesweep.unproject(camera, depth)
    on_floor = points[..., 1] > FLOOR - 1e-6
    out = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    for place, axis, seed in ((~on_floor, 1, 0), (on_floor, 2, 1)):
        u = ((points[..., 0] + 4) * 64).astype(np.float32)
        v = ((points[..., axis] + 4) * 64 % 511).astype(np.float32)
        sampled = cv2.remap(texture(seed), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        out[place] = sampled[place]
    out[on_floor & (np.abs(points[..., 0]) < bare)] = 120
    return out.astype(np.uint8)


def make_images(cameras: list[Camera], bare: float = 0) -> np.ndarray:
    return np.stack([make_image(c, bare) for c in cameras])
