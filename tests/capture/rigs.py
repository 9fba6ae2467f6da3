"""Synthetic rigs around known points, as models of pycolmap."""

from itertools import combinations
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

SPREAD = 2.0
"""Half the side of the cube of points, 5 units away; they fill most of each image."""


def rig(colmap: Any, noise: float = 0.0, seed: int = 0, spread: float = SPREAD, lenses: int = 8) -> Any:
    """Return eight cameras around points whose lenses have their middle off the image's.

    Args:
        colmap: Module pycolmap.
        noise: Standard deviation of the places of its few points in the images, in pixels.
        seed: Seed of the noise and the points; the cameras are always the same.
        spread: Half the side of the cube of points.
        lenses: Number of lenses, which cameras share.
    """
    colmap.set_random_seed(seed)
    options, rng = colmap.SyntheticDatasetOptions(), np.random.default_rng(2)
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = lenses, 8 // lenses, 60
    options.camera_width, options.camera_height = 640, 480
    options.camera_params, options.num_points2D_without_point3D = [380, 326, 235, -0.1], 0
    made = colmap.synthesize_dataset(options)
    other = np.random.default_rng((2, seed))
    for point, place in zip(made.points3D.values(), rng.uniform(-spread, spread, (60, 3)), strict=True):
        point.xyz = place if seed == 0 else other.uniform(-spread, spread, 3)
    for number, image in enumerate(images(made)):
        angles = [22 * number, [-25, 5, 30][number % 3], 50 * number]  # a level ring would leave the lens's middle open
        turn = Rotation.from_euler("yxz", angles, degrees=True).as_matrix().T
        place = [*rng.uniform(-1, 1, 2), rng.uniform(3.5, 6.5)]  # nor would cameras that all look at one point tell it
        pose = colmap.Rigid3d(colmap.Rotation3d(turn), np.array(place))
        made.frame(image.frame_id).set_cam_from_world(image.camera_id, pose)
        for point in image.points2D:
            place = image.camera.img_from_cam(image.cam_from_world() * made.point3D(point.point3D_id).xyz)
            point.xy = place + other.normal(0, noise, 2)
    return made


def images(model: Any) -> list[Any]:
    return sorted((model.image(number) for number in model.reg_image_ids()), key=lambda image: image.name)


def disturb(colmap: Any, model: Any) -> None:
    """Turn each camera by about a degree, and put the middle of its lens into the middle of the image."""
    rng = np.random.default_rng(1)
    for image in images(model):
        pose = image.cam_from_world()
        turn = Rotation.from_rotvec(rng.normal(0, 0.006, 3)).as_matrix() @ pose.rotation.matrix()
        model.frame(image.frame_id).set_cam_from_world(
            image.camera_id, colmap.Rigid3d(colmap.Rotation3d(turn), pose.translation)
        )
        image.camera.params = [605, 320, 240, 0]


def rotations(model: Any) -> list[np.ndarray]:
    return [image.cam_from_world().rotation.matrix() for image in images(model)]


def turned(model: Any, known: list[np.ndarray]) -> float:
    """Return the median error of the rotations between cameras, in degrees."""
    found = rotations(model)
    errors = [
        Rotation.from_matrix((found[a] @ found[b].T) @ (known[a] @ known[b].T).T).magnitude()
        for a, b in combinations(range(len(found)), 2)
    ]
    return float(np.degrees(np.median(errors)))
