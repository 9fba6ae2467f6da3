"""Small known scenes."""

import numpy as np

from splatreel.scene import rotations
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians


def random_gaussians(count: int, seed: int = 0, sh_degree: int = 1, spread: float = 1.0) -> Gaussians:
    rng = np.random.default_rng(seed)
    return Gaussians(
        rng.uniform(-spread, spread, (count, 3)),
        rotations.normalize(rng.normal(size=(count, 4))),
        rng.uniform(0.03, 0.1, (count, 3)),
        rng.uniform(0.3, 0.95, count),
        rng.normal(size=(count, (sh_degree + 1) ** 2, 3)) * 0.3,
    )


def look_at(position, target=(0.0, 0.0, 0.0), width=48, height=32, name="cam", focal=None) -> Camera:
    """A camera at position that looks at target, with y down in the image and +y down in the world."""
    position, target = np.asarray(position, float), np.asarray(target, float)
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross([0, 1.0, 0], z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    viewmat = np.eye(4)
    viewmat[:3, :3] = [x, y, z]
    viewmat[:3, 3] = -viewmat[:3, :3] @ position
    f = focal or width
    K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
    return Camera(name, viewmat, K, width, height)


def ring(count: int, radius: float = 4.0, **kwargs) -> list[Camera]:
    """Cameras on an arc of 60 degrees that look at the origin."""
    angles = np.linspace(-np.pi / 6, np.pi / 6, count)
    return [
        look_at([radius * np.sin(a), 0.4 * (i % 2) - 0.2, -radius * np.cos(a)], name=f"cam{i:02d}", **kwargs)
        for i, a in enumerate(angles)
    ]
