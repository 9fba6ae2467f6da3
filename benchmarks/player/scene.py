"""Write one static scene in the formats of all players, with an orbit of cameras and a reference image."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from splatreel.codec.header import ReelHeader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.formats.ply import read_ply, write_ply
from splatreel.kernels.image import render_image
from splatreel.play.timeline import open_reel
from splatreel.scene import rotations
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

LARGEST = 0.03
"""Standard deviation of the largest splat of a point cloud, world units: the players clamp larger ones differently."""


def read_points(path: Path) -> Gaussians:
    """Return a 3DGS PLY as it is, or colored points as Gaussians about as large as the distance to their neighbors."""
    if path.suffix == ".ply":
        return read_ply(path)
    with np.load(path) as data:
        means, colors = data["means3d"].astype(np.float32), data["colors"] / 255
    rng = np.random.default_rng(0)
    near = KDTree(means).query(means, k=4)[0][:, 1:].mean(1)
    scales = np.clip(near[:, None] * rng.uniform(0.3, 1.2, (len(means), 3)), 0.001, LARGEST)
    return Gaussians(
        means=means,
        quats=rotations.normalize(rng.normal(size=(len(means), 4))),
        scales=scales,
        opacities=rng.beta(2, 1, len(means)),
        sh=((colors - 0.5) / 0.28209479177387814)[:, None],
    )


def write_scene(points: Gaussians, count: int, folder: Path, size: list[int], pictures: int) -> Path:
    """Write reel/, scene.ply and scene.json into a folder; returns the CPU's picture at the first pose, an npy [H, W, 3]."""
    rng = np.random.default_rng(1)
    points = points[np.sort(rng.permutation(len(points))[:count])]
    poses, focal = orbit(points.means, pictures, size)
    first = camera(poses[0], focal, size)
    low, high = np.percentile(points.means, [5, 95], axis=0)
    header = ReelHeader(
        fps=30,
        group_length=1,
        overlap=0,
        sh_degree=points.sh_degree,
        bounds=np.stack([low, high]),
        up=np.array([0.0, 0.0, 1.0]),
        camera=first,
        cameras=[first],
        near=0.05,
    )
    writer = ReelWriter(folder / "reel", header, config=EncodeConfig())
    writer.add_layer(0, 0, points)
    nothing = Gaussians.empty(points.sh_degree)
    writer.add_group(Group(0, 0, nothing, np.zeros((1, 0, 3)), np.zeros((1, 0, 4)), np.ones(len(points), bool)))
    writer.finish()
    decoded = open_reel(folder / "reel").at(0)
    write_ply(folder / "scene.ply", decoded)
    (folder / "scene.json").write_text(json.dumps({"focal": focal, "poses": [pose.ravel().tolist() for pose in poses]}))
    truth = folder / "truth.npy"
    np.save(truth, np.clip(render_image(decoded, first, near=0.05), 0, 1))
    return truth


def orbit(means: np.ndarray, pictures: int, size: list[int]) -> tuple[list[np.ndarray], float]:
    """Return world-to-camera matrices [4, 4] around the middle of the points, and a focal length in pixels."""
    middle = np.median(means, axis=0)
    reach = 1.2 * np.percentile(np.linalg.norm(means - middle, axis=1), 60)
    poses = []
    for angle in np.linspace(0, 2 * np.pi, pictures, endpoint=False):
        back = np.array([np.cos(angle), np.sin(angle), 0.45])
        eye = middle + reach * back
        forward = -back / np.linalg.norm(back)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = [right, np.cross(forward, right), forward]
        pose[:3, 3] = -pose[:3, :3] @ eye
        poses.append(pose)
    return poses, 0.9 * size[0]


def camera(viewmat: np.ndarray, focal: float, size: list[int]) -> Camera:
    width, height = size
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera("start", viewmat, K, width, height)
