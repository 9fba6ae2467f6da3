"""Export of a reel as a .blend file that plays in Blender without add-on and without Python.

The motion of a group is a sum of a few vectors per Gaussian, each times a value that Blender animates. `blender_scene` writes the file
in a process of its own, because Blender's module is under the GPL and needs a Python of its own.
"""

from __future__ import annotations

import importlib.util
import json
import math
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
from scipy.spatial.transform import Rotation

from splatreel.base.atomic import move, scratch
from splatreel.base.errors import GaussiansError, MissingDependencyError, UsageError
from splatreel.play import blender_scene
from splatreel.play.film import CameraPath, film_along_path, sound_start
from splatreel.play.gaussian_export import GaussianExport
from splatreel.play.reel_sound import ReelSound
from splatreel.scene import rotations
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.group import Group

MOST_VECTORS = 32
_POSITION, _ROTATION, _SHADE = 1e-4, 5e-3, 5e-3
"""Largest errors: of positions relative to the extent of the group's motion, of rotations in radians, of colors and opacities."""
_THINNEST = 2e-5
"""Smallest standard deviation relative to the extent of the positions. Single precision cannot place rays on thinner ellipsoids."""
_SENSOR = 36.0
"""Width of a camera's sensor in millimeters, which gives a focal length its usual number."""
_SHOWN_LINES = 8
"""Last lines of Blender's output that an error shows."""


class Motion(NamedTuple):
    """Changes over time as a sum of vectors times values: curves [T, K] @ vectors [K, N, C]. `error` is the largest difference."""

    curves: np.ndarray
    vectors: np.ndarray
    error: float


def fit_motion(changes: np.ndarray, tolerance: float) -> Motion:
    """Return the fewest vectors that keep the largest error within the tolerance, at most `MOST_VECTORS`.

    The vectors are the principal components over time, scaled to at most 1 and rounded, which compresses better.

    Args:
        changes: [T, N, C] differences from a state at rest.
        tolerance: Largest error, in the units of the changes.
    """
    frames, shape = len(changes), changes.shape[1:]
    left = changes.reshape(frames, math.prod(shape)).astype(np.float64)
    curves, vectors = np.zeros((frames, 0)), np.zeros((0, left.shape[1]))
    axes = np.linalg.eigh(left @ left.T)[1][:, ::-1]
    error = float(np.abs(left).max(initial=0))
    for axis in axes.T[:MOST_VECTORS]:
        if error <= tolerance:
            break
        vector = axis @ left
        scale = np.abs(vector).max()
        if scale == 0:
            break
        curve = axis * scale
        step = 2.0 ** np.floor(np.log2(tolerance / (MOST_VECTORS / 2) / np.abs(curve).max()))
        vector = np.rint(vector / scale / step) * step
        left -= np.outer(curve, vector)
        curves, vectors = np.column_stack([curves, curve]), np.vstack([vectors, vector])
        error = float(np.abs(left).max())
    return Motion(curves, vectors.reshape(len(vectors), *shape).astype(np.float32), error)


def rotation_changes(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations at rest [N, 4], and rotation vectors [T, N, 3] in the frames of the points that lead to `quats` [T, N, 4].

    The vectors change continuously: their angle may exceed half a turn.
    """
    rest = quats[len(quats) // 2].astype(np.float64)
    change = rotations.multiply(np.broadcast_to(rotations.conjugate(rest), quats.shape), quats.astype(np.float64))
    vectors = Rotation.from_quat(change.reshape(-1, 4), scalar_first=True).as_rotvec().reshape(*quats.shape[:2], 3)
    middle = len(quats) // 2
    for part in (vectors[middle:], vectors[middle::-1]):
        for before, now in pairwise(part):
            angle = np.linalg.norm(now, axis=1, keepdims=True)
            last = before / np.maximum(np.linalg.norm(before, axis=1, keepdims=True), 1e-9)
            axis = np.where(angle > 1e-6, now / np.maximum(angle, 1e-9), last)
            turns = np.rint((np.sum(before * axis, axis=1, keepdims=True) - angle) / (2 * np.pi))
            now += axis * 2 * np.pi * turns
    return rest, vectors


@dataclass
class BlendScene:
    """Arrays and description from which `blender_scene` makes a file.

    Attributes:
        arrays: Arrays by name. Those of the object with number i start with `i/`.
        description: JSON value with the settings of the scene, its objects and its cameras.
        vectors: Largest number of vectors that move the positions of a group.
        error: Largest error of positions, relative to the extent of the motion of a group.
        color_error: Largest error of colors and opacities, 0..1.
        lacks_sound: The sound was left out, since the module `bpy` is built without.
    """

    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    description: dict[str, Any] = field(default_factory=lambda: {"objects": [], "cameras": [], "sound": None})
    vectors: int = 0
    error: float = 0.0
    color_error: float = 0.0
    lacks_sound: bool = False

    def add_object(self, name: str, frames: tuple[int, int] | None, **arrays: np.ndarray) -> None:
        """Add an object that shows from the first to the last of `frames`, or always for None. No points add nothing."""
        if len(arrays["position"]):
            prefix = f"{len(self.description['objects'])}/"
            self.description["objects"].append({"name": name, "frames": frames})
            self.arrays |= {prefix + key: np.asarray(array, np.float32) for key, array in arrays.items()}

    def add_camera(
        self, camera: Camera, name: str, near: float, poses: np.ndarray, frames: Sequence[float] = ()
    ) -> None:
        """Add a camera. poses: [F, 7], see `_pose`, at `frames`; [1, 7] without frames for one that does not move."""
        width, (cx, cy) = camera.width, camera.K[:2, 2].tolist()
        self.arrays[f"camera{len(self.description['cameras'])}"] = poses
        self.description["cameras"].append(
            {
                "name": name,
                "lens": float(camera.K[0, 0]) / width * _SENSOR,
                "shift": [(width / 2 - cx) / width, (cy - camera.height / 2) / width],
                "near": near,
                "frames": list(frames),
            }
        )


def make_scene(film: GaussianExport, fps: float, path: CameraPath | None = None) -> BlendScene:
    """Return the arrays of a film.

    Args:
        film: Frames, crop, and the axes of the file. A Gaussian is kept if it is in the crop at any frame of its group.
        fps: Frames per second of the file.
        path: Path of the scene's camera.

    Raises:
        UsageError: The path plays the reel at another speed than its own.
    """
    source, scene = film.source, BlendScene()
    frames = np.rint(np.array(film.seconds) * source.fps).astype(int)
    shown = [[(group.index, weight) for group, weight in source.groups_at(frame)] for frame in frames]
    order = sorted({index for groups in shown for index, _ in groups})
    lights = np.ones((len(frames), 3))
    alive: dict[int, np.ndarray] = {}
    for place, index in enumerate(order):
        group = source.reel.group(index)
        own = [number for number, groups in enumerate(shown) if index in dict(groups)]
        for number in own:
            light = group.light_at(frames[number] - group.first_frame) if shown[number][-1][0] == index else None
            lights[number] = lights[number] if light is None else light
        _add_group(scene, film, group, frames[own], place, (own[0], own[-1]))
        _note_alive(alive, film, group, place, len(order))
    for layer, table in alive.items():
        _add_layer(scene, film, layer, table)
    last = [groups[-1] for groups in shown]
    scene.arrays["progress"] = np.array([order.index(index) - 1 + weight for index, weight in last])
    if (lights != 1).any():
        scene.arrays["light"] = lights
    manifest = source.manifest
    scene.description |= {
        "fps": fps,
        "frames": len(frames),
        "size": [manifest.camera.width, manifest.camera.height],
        "background": _linear(np.asarray(manifest.background)).tolist(),
    }
    _add_cameras(scene, film, fps, path)
    return scene


def _add_group(
    scene: BlendScene, film: GaussianExport, group: Group, frames: np.ndarray, place: int, span: tuple[int, int]
) -> None:
    """Add the dynamic points of a group at some frames of the reel, which the file shows at the frames of `span`."""
    times = np.clip(frames - group.first_frame, 0, group.frames - 1)
    means = group.dynamic.means + group.dx[times]
    inside = np.ones(len(group.dynamic), bool)
    if film.crop is not None:
        inside = np.any([film.crop.contains(frame) for frame in means], axis=0)
    points, means = group.dynamic[inside], means[:, inside]
    if not len(points):
        return
    turn = film.placement.turn
    means = means.astype(np.float64) @ rotations.to_matrix(turn).T
    quats = rotations.multiply(points.quats, rotations.normalize(group.dq[times][:, inside]))
    quats = rotations.multiply(np.broadcast_to(turn, quats.shape), quats)
    shade = np.zeros((len(times), len(points), 4)) if group.shade is None else group.shade[times][:, inside]
    center, mean_shade = means.mean(0), shade.mean(0)
    extent = float(np.linalg.norm(np.ptp(means.reshape(-1, 3), axis=0)))
    rest, turned = rotation_changes(quats)
    motions = {
        "position": fit_motion(means - center, _POSITION * extent),
        "rotation": fit_motion(turned, _ROTATION),
        "color": fit_motion(C0 * (shade - mean_shade)[..., :3], _SHADE),
        "opacity": fit_motion((shade - mean_shade)[..., 3], _SHADE),
    }
    scene.vectors = max(scene.vectors, motions["position"].curves.shape[1])
    scene.error = max(scene.error, motions["position"].error / max(extent, 1e-12))
    scene.color_error = max(scene.color_error, motions["color"].error, motions["opacity"].error)
    moving = {f"{name}_curves": motion.curves for name, motion in motions.items()}
    moving |= {f"{name}_vectors": motion.vectors for name, motion in motions.items()}
    look = {"color": points.base_colors + C0 * mean_shade[:, :3], "opacity": points.opacities + mean_shade[:, 3]}
    always = np.full(len(points), place)
    scene.add_object(
        f"group {group.index}",
        span,
        **_attributes(points, center, rest, always, always) | look | moving,
    )


def _attributes(
    points: Gaussians, means: np.ndarray, quats: np.ndarray, first: np.ndarray, last: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the attributes of a mesh. first, last: [N] places of the groups that show a point, which do not count its fades."""
    extent = np.linalg.norm(np.ptp(means, axis=0))
    return {
        "position": means,
        "rotation": quats,
        "scale": np.maximum(points.scales, _THINNEST * extent),
        "color": points.base_colors,
        "opacity": points.opacities,
        "shown_from": first,
        "shown_until": last,
    }


def _note_alive(alive: dict[int, np.ndarray], film: GaussianExport, group: Group, place: int, places: int) -> None:
    """Enter the points that a group shows into a table [places, P] bool for each static layer."""
    manifest, start = film.source.manifest, 0
    for layer in manifest.living_layers(group.index):
        count = manifest.layers[layer].points
        alive.setdefault(layer, np.zeros((places, count), bool))[place] = group.alive[start : start + count]
        start += count


def _add_layer(scene: BlendScene, film: GaussianExport, layer: int, table: np.ndarray) -> None:
    """Add the static points of a layer: one for each run of groups that show it."""
    points = film.source.reel.layer(layer)
    steps = np.diff(np.pad(table.T.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, first = np.nonzero(steps == 1)
    last = np.nonzero(steps == -1)[1] - 1
    if film.crop is not None:
        inside = film.crop.contains(points.means)[rows]
        rows, first, last = rows[inside], first[inside], last[inside]
    if not len(rows):
        return
    points, turn = points[rows], film.placement.turn
    means = points.means.astype(np.float64) @ rotations.to_matrix(turn).T
    quats = rotations.multiply(np.broadcast_to(turn, points.quats.shape), points.quats)
    scene.add_object(f"static {layer}", None, **_attributes(points, means, quats, first, last))


def _add_cameras(scene: BlendScene, film: GaussianExport, fps: float, path: CameraPath | None) -> None:
    """Add the camera of a path, the start camera, and those of the capture."""
    manifest, turn = film.source.manifest, film.placement.turn
    near = manifest.near
    if path is not None:
        shots = film_along_path(path, manifest.camera, film.source.fps)
        if sound_start(shots, film.source.fps) is None:
            raise UsageError(
                "The camera path slows the reel down or speeds it up, which .blend files cannot. Save one at its speed."
            )
        poses = np.array([_pose(camera, turn) for _, camera in shots])
        for before, now in pairwise(poses):
            now[3:] *= -1 if before[3:] @ now[3:] < 0 else 1
        times = [(seconds - film.seconds[0]) * fps for seconds, _ in shots]
        scene.add_camera(manifest.camera, "path", near, poses, times)
    for name, camera in (("start", manifest.camera), *((camera.name, camera) for camera in manifest.cameras)):
        scene.add_camera(camera, name, near, _pose(camera, turn)[None])


def _pose(camera: Camera, turn: np.ndarray) -> np.ndarray:
    """Return location and rotation (wxyz), [7], of a camera of Blender, whose y axis points up and whose z axis points back."""
    rotation = rotations.to_matrix(turn) @ camera.viewmat[:3, :3].T.astype(np.float64) @ np.diag([1.0, -1, -1])
    location = rotations.to_matrix(turn) @ camera.center
    return np.concatenate([location, Rotation.from_matrix(rotation).as_quat(scalar_first=True)])


def _linear(color: np.ndarray) -> np.ndarray:
    """Return the linear light of sRGB values."""
    return np.where(color <= 0.04045, color / 12.92, ((np.maximum(color, 0) + 0.055) / 1.055) ** 2.4)


def write_blend(path: Path, film: GaussianExport, fps: float, camera_path: CameraPath | None = None) -> BlendScene:
    """Write a .blend file, atomically, and return what it holds.

    Args:
        path: File to write.
        film: See `make_scene`.
        fps: Frames per second of the file.
        camera_path: See `make_scene`.

    Raises:
        MissingDependencyError: There is neither the module `bpy` nor the program `blender`.
        UsageError: See `make_scene`.
        GaussiansError: Blender failed.
    """
    command = _blender_command()
    scene = make_scene(film, fps, camera_path)
    with scratch(path.parent, path.name) as folder:
        sound = film.source.sound
        if sound is not None:
            file = folder / "sound.flac"
            _write_sound(file, sound, film.seconds[0], len(film.seconds) / fps)
            scene.description["sound"] = str(file.resolve())
        arrays: dict[str, Any] = scene.arrays | {"scene": np.array(json.dumps(scene.description))}
        np.savez(folder / "arrays.npz", **arrays)
        made = folder / "made.blend"
        arguments = [str((folder / "arrays.npz").resolve()), str(made.resolve())]
        ended = subprocess.run([*command, *arguments], capture_output=True, text=True, errors="replace")
        if ended.returncode or not made.exists():
            lines = (ended.stdout + ended.stderr).strip().splitlines()[-_SHOWN_LINES:]
            raise GaussiansError(
                f"{path}: {Path(command[0]).name} ended with exit code {ended.returncode} and did not write it:\n"
                + "\n".join(lines)
            )
        scene.lacks_sound = blender_scene.NO_SOUND in ended.stdout
        move(made, path)
    return scene


def _blender_command() -> list[str]:
    """Return the command that runs `blender_scene`, up to its arguments."""
    script = blender_scene.__file__
    if blender := shutil.which("blender"):
        start = [blender, "--background", "--factory-startup", "--python-exit-code", "1"]
        return [*start, "--python", script, "--"]
    if importlib.util.find_spec("bpy") is not None:
        run = "import bpy, runpy, sys; runpy.run_path(sys.argv[1], run_name='__main__')"
        return [sys.executable, "-P", "-c", run, script, "--"]
    raise MissingDependencyError(
        ".blend files are written by Blender, 4.2 or newer. Install it and put the folder of the program blender in PATH, or run\n"
        "  pip install bpy\nin a Python of the version that bpy needs."
    )


def _write_sound(file: Path, sound: ReelSound, start: float, seconds: float) -> None:
    """Write a range of the sound as FLAC."""
    layout = "mono" if sound.channels == 1 else "stereo"
    with av.open(str(file), "w", format="flac") as container:
        stream = container.add_stream("flac", rate=sound.rate, layout=layout)
        for at in np.arange(0, seconds, 10.0).tolist():
            samples = sound.samples(start + at, min(10.0, seconds - at))
            data = np.rint(np.clip(samples, -1, 1) * 32767).astype(np.int16)
            frame = av.AudioFrame.from_ndarray(data.reshape(1, -1), "s16", layout)
            frame.sample_rate, frame.pts = sound.rate, round(at * sound.rate)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
