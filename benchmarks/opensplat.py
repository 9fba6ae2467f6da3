"""Train one frame with OpenSplat and with Splatreel on the CPU, from the same points, and compare PSNR and seconds.

python benchmarks/opensplat.py CAPTURE --program PATH/TO/opensplat --iterations 300 --width 672

OpenSplat (its license is AGPL; nothing of it is part of this project) is built with cmake, `-DGPU_RUNTIME=CPU`, against OpenCV and the
libtorch of the torch wheel: `-DCMAKE_PREFIX_PATH=$(python -c 'import torch; print(torch.utils.cmake_prefix_path)')`.
"""

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro

from bench.oracle import held_out_views
from record import record
from splatreel.base import threads
from splatreel.base.process import keep_freed_memory
from splatreel.capture.base import Capture
from splatreel.capture.opening import open_capture
from splatreel.config import Config
from splatreel.config.settings import changed
from splatreel.evaluation.metrics import psnr, ssim
from splatreel.formats.ply import read_ply
from splatreel.kernels.image import render_image
from splatreel.method.train.single_frame import lay_out, reconstruct_single_frame
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From the axes of our cameras to those of nerfstudio's."""
HALVINGS = 2
"""OpenSplat begins at a quarter of the size by default, and doubles it after each 3,000 iterations: here after each third."""


def main(
    capture: tyro.conf.Positional[Path],
    /,
    program: Path,
    iterations: int = 300,
    width: int | None = None,
    note: str = "",
) -> None:
    """Train the first frame with both programs, one after the other, and compare them on the held-out cameras."""
    keep_freed_memory()
    source = open_capture(capture, width=width)
    found = compare(source, program, iterations)
    size = {"width": source.width, "height": source.height, "cameras": len(source.training_cameras)}
    record(f"opensplat {source.name}", size | {"threads": threads.count(), "iterations": iterations} | found, note)


def compare(source: Capture, program: Path, iterations: int) -> dict[str, Any]:
    """Return PSNR and SSIM of held-out cameras, seconds, CPU seconds and points of both, and the ratio of their times.

    CPU seconds are summed over the cores. Other programs hardly change them.
    """
    cameras, views = source.training_cameras, held_out_views(source)
    images = source.read(0, 1, [camera.name for camera in cameras])[0]
    truths = source.read(0, 1, [view.name for view in views])[0].astype(np.float32) / 255
    config = changed(Config(), {"keyframe.first_iterations": iterations})
    seeds, layout = lay_out(cameras, images, config, source.points, source.point_colors, source.near)
    start = {"points": seeds.points, "point_colors": seeds.colors, "near": source.near}
    with tempfile.TemporaryDirectory() as name:
        project = Path(name)
        write_project(project, cameras, images, seeds.points, seeds.colors)
        theirs, their_time = opensplat(program, project, iterations)
    reconstruct_single_frame(cameras, images, changed(config, {"keyframe.first_iterations": 2}), **start)  # compiles
    begun = clock()
    ours, _ = reconstruct_single_frame(cameras, images, config, **start)
    our_time = clock() - begun
    plain = partial(render_image, near=layout.near)
    drawn = partial(plain, antialias=config.antialias, background=layout.background)
    found: dict[str, Any] = {}
    for name, times, points, draw in (
        ("opensplat", their_time, theirs, plain),
        ("ours", our_time, ours, drawn),
    ):
        spent = dict(zip(("seconds", "cpu_seconds"), times.round(1).tolist(), strict=True))
        found[name] = spent | {"points": len(points)} | compared(points, views, truths, draw)
        print(name, found[name], flush=True)
    seconds, cpu_seconds = (their_time / our_time).round(2).tolist()
    return found | {"times_as_long": seconds, "times_the_cpu_seconds": cpu_seconds}


def clock() -> np.ndarray:
    """Return seconds, and CPU seconds of this process and its finished children, [2] float64. Only differences have a meaning."""
    return np.array([time.monotonic(), sum(os.times()[:4])])


def write_project(
    folder: Path, cameras: list[Camera], images: np.ndarray, points: np.ndarray, colors: np.ndarray
) -> None:
    """Write a nerfstudio project.

    Args:
        images: [C, H, W, 3] uint8.
        points: [P, 3] positions.
        colors: [P, 3], 0..1.
    """
    frames = []
    for camera, image in zip(cameras, images, strict=True):
        cv2.imwrite(str(folder / f"{camera.name}.png"), image[..., ::-1])
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        pose = np.linalg.inv(camera.viewmat.astype(np.float64)) @ OPENGL
        lens = {"w": camera.width, "h": camera.height, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
        frames.append({"file_path": f"{camera.name}.png", "transform_matrix": pose.tolist()} | lens)
    about = {"camera_model": "OPENCV", "ply_file_path": "points.ply", "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(about), encoding="utf-8")
    rows = np.zeros(len(points), [(axis, "<f4") for axis in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")])
    for axis, values in zip("xyz", points.T, strict=True):
        rows[axis] = values
    for channel, values in zip(("red", "green", "blue"), colors.T, strict=True):
        rows[channel] = np.rint(255 * np.clip(values, 0, 1))
    kinds = [f"property float {axis}" for axis in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *kinds, "end_header", ""]
    (folder / "points.ply").write_bytes("\n".join(header).encode() + rows.tobytes())


def opensplat(program: Path, project: Path, iterations: int) -> tuple[Gaussians, np.ndarray]:
    """Run OpenSplat; return its points in our coordinates, and the seconds and CPU seconds of its process."""
    ply = project / "splat.ply"
    command = [str(program), str(project), "--cpu", "--keep-crs", "-n", str(iterations), "-o", str(ply)]
    command += ["--num-downscales", str(HALVINGS), "--resolution-schedule", str(max(iterations // 3, 1))]
    begun = clock()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=os.environ | {"OMP_WAIT_POLICY": "passive"})
    taken = clock() - begun
    return read_ply(ply), taken


def compared(
    points: Gaussians, views: list[Camera], truths: np.ndarray, draw: Callable[[Gaussians, Camera], np.ndarray]
) -> dict[str, float]:
    """Return means over the held-out cameras."""
    pairs = [(np.clip(draw(points, view), 0, 1), truth) for view, truth in zip(views, truths, strict=True)]
    return {
        "psnr": round(float(np.mean([psnr(image, truth) for image, truth in pairs])), 2),
        "ssim": round(float(np.mean([ssim(image, truth) for image, truth in pairs])), 4),
    }


if __name__ == "__main__":
    tyro.cli(main)
