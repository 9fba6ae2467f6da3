"""Conversion of any capture to a folder that EasyVolcap, COLMAP and Splatreel read.

Images are undistorted and synchronized: `images/CAMERA/000000.jpg`. `intri.yml` and `extri.yml` are EasyVolcap's, and
`sparse/0` is a COLMAP model of the first frames, with the capture's sparse points.

Source: EasyVolcap's `write_camera` (`easyvolcap/utils/easy_utils.py`); COLMAP's documentation, "Output Format".
"""

from __future__ import annotations

import json
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from splatreel.base import threads
from splatreel.base.errors import CaptureError
from splatreel.base.new_folder import new_folder
from splatreel.base.progress import Progress
from splatreel.capture.base import Capture
from splatreel.capture.images import encode_image
from splatreel.capture.lens import import_cv2
from splatreel.capture.readers.easyvolcap import EXTRINSICS, INTRINSICS
from splatreel.capture.sidecar import SIDECAR
from splatreel.scene.camera import Camera

Format = Literal["jpg", "png"]
QUALITY: dict[Format, dict[str, Any]] = {"jpg": {"quality": 97, "subsampling": 0}, "png": {"compress_level": 1}}
"""Options of Pillow. PNG keeps every pixel."""
CHUNK_PIXELS = 200_000_000
"""Maximum number of pixels in memory at a time."""
UNUSUAL = re.compile(r"[^A-Za-z0-9_-]")
"""Characters that a key of OpenCV's files cannot have."""


def convert_capture(capture: Capture, out: Path, kind: Format, progress: Progress) -> dict[str, str]:
    """Write a capture as undistorted images with the cameras of EasyVolcap and COLMAP.

    Args:
        capture: Open capture.
        out: New folder. It may hold the same output of an earlier command.
        kind: File format of the images.
        progress: Progress display.

    Returns:
        The new name of each camera.

    Raises:
        CaptureError: The folder holds something else, or two names become equal.
    """
    names = {camera.name: UNUSUAL.sub("_", camera.name) for camera in capture.cameras}
    if len(set(names.values())) < len(names):
        raise CaptureError(
            f"{capture.path}: cameras would have equal names: {', '.join(names)}. Use letters, digits, - and _ in names."
        )
    with new_folder(out, CaptureError(f"{out}: exists already. Name a new folder.")) as made:
        cameras = {names[camera.name]: camera for camera in capture.cameras}
        _write_easyvolcap(made.path, cameras)
        _write_model(made.path / "sparse" / "0", cameras, capture, kind)
        facts = {"fps": capture.fps, "held_out": [names[name] for name in capture.held_out]}
        (made.path / SIDECAR).write_text(json.dumps(facts, indent=1) + "\n")
        _write_images(made.path / "images", capture, names, kind, made.checked(progress))
    return names


def _write_easyvolcap(folder: Path, cameras: dict[str, Camera]) -> None:
    cv2 = import_cv2("Writing EasyVolcap's cameras")
    # In memory, since OpenCV says nothing of a full disk.
    intrinsics = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    extrinsics = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for storage in (intrinsics, extrinsics):
        storage.write("names", list(cameras))
    for name, camera in cameras.items():
        rotation, translation = camera.viewmat[:3, :3].astype(float), camera.viewmat[:3, 3:].astype(float)
        intrinsics.write(f"K_{name}", camera.K.astype(float))
        intrinsics.write(f"H_{name}", float(camera.height))
        intrinsics.write(f"W_{name}", float(camera.width))
        intrinsics.write(f"D_{name}", np.zeros((5, 1)))
        extrinsics.write(f"R_{name}", Rotation.from_matrix(rotation).as_rotvec()[:, None])
        extrinsics.write(f"Rot_{name}", rotation)
        extrinsics.write(f"T_{name}", translation)
    for name, storage in ((INTRINSICS, intrinsics), (EXTRINSICS, extrinsics)):
        (folder / name).write_text(storage.releaseAndGetString(), encoding="utf-8")


def _write_model(folder: Path, cameras: dict[str, Camera], capture: Capture, kind: Format) -> None:
    """Write a COLMAP model as text, whose images are the first one of each camera."""
    folder.mkdir(parents=True)
    lenses, images, points = [], [], []
    for number, (name, camera) in enumerate(cameras.items(), 1):
        K, viewmat = camera.K.astype(float), camera.viewmat.astype(float)
        numbers = _text([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
        lenses.append(f"{number} PINHOLE {camera.width} {camera.height} {numbers}\n")
        quat = Rotation.from_matrix(viewmat[:3, :3]).as_quat(scalar_first=True)
        images.append(f"{number} {_text([*quat, *viewmat[:3, 3]])} {number} {name}/{_file_name(0, kind)}\n\n")
    if capture.points is not None:
        colors = np.full((len(capture.points), 3), 128) if capture.point_colors is None else capture.point_colors * 255
        for number, (point, color) in enumerate(zip(capture.points.tolist(), colors, strict=True), 1):
            points.append(f"{number} {_text(point)} {' '.join(str(round(float(value))) for value in color)} 0\n")
    for file, lines in (("cameras", lenses), ("images", images), ("points3D", points)):
        (folder / f"{file}.txt").write_text("".join(lines))


def _text(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _file_name(frame: int, kind: Format) -> str:
    return f"{frame:06d}.{kind}"


def _write_images(folder: Path, capture: Capture, names: dict[str, str], kind: Format, progress: Progress) -> None:
    for name in names.values():
        (folder / name).mkdir(parents=True)
    chunk = max(CHUNK_PIXELS // (len(names) * capture.width * capture.height), 1)
    progress.stage("writing images", capture.frames)
    with ThreadPoolExecutor(threads.count()) as pool:
        for first in range(0, capture.frames, chunk):
            count = min(chunk, capture.frames - first)
            frames, missing = capture.read(first, count, list(names)), capture.missing(first, count, list(names))
            jobs = [
                pool.submit(_save, folder / name / _file_name(first + t, kind), frames[t, c], kind)
                for t in range(count)
                for c, name in enumerate(names.values())
                if not missing[t, c]
            ]
            for job in jobs:
                job.result()
            progress.update(first + count)


def _save(file: Path, pixels: np.ndarray, kind: Format) -> None:
    file.write_bytes(encode_image(pixels, file.suffix, **QUALITY[kind]))
