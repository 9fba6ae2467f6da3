"""Calibrate a capture with known cameras from a few of its frames, and record how far the poses are off.

The known poses are the truth. Positions are compared after a similarity alignment of the camera centers, and rotations
after an alignment of the rotations: the centers of cameras on a narrow arc hardly tell how the rig is turned. The record
also has the rotations after the alignment of centers (`by_centers_degrees`). Thinned rigs are the cameras that are
farthest from each other. Each rig that is refused is calibrated with the
extra `match` too.

python benchmarks/calibration.py FILM                                            built-in, kitchen, yard, ...
python benchmarks/calibration.py basketball --path CAPTURE --frames 0 30 59
python benchmarks/calibration_page.py                                            writes the table of docs/calibration.md
"""

import importlib
import tempfile
from contextlib import ExitStack, closing
from pathlib import Path

import av
import numpy as np
import tyro

from record import record
from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.calibration.calibrate import calibrate
from splatreel.calibration.learned_matches import find_matcher
from splatreel.capture.base import Capture
from splatreel.capture.opening import open_capture
from splatreel.scene.camera import Camera
from toyroom.capture import make_capture

BUILT_IN = "built-in"


def thin(cameras: list[Camera], count: int) -> list[Camera]:
    """Return cameras that are far from each other, beginning with the first."""
    centers, kept = np.stack([camera.center for camera in cameras]), [0]
    while len(kept) < min(count, len(cameras)):
        gaps = np.linalg.norm(centers[:, None] - centers[kept][None], axis=2).min(1)
        kept.append(int(gaps.argmax()))
    return [cameras[number] for number in sorted(kept)]


def write_videos(capture: Capture, cameras: list[Camera], frames: list[int], folder: Path) -> None:
    """Write a lossless video of the frames for each camera."""
    for camera in cameras:
        with av.open(str(folder / f"{camera.name}.mkv"), "w") as container:
            stream = container.add_stream("ffv1", rate=30)
            stream.width, stream.height, stream.pix_fmt = camera.width, camera.height, "bgr0"
            for frame in frames:
                image = np.ascontiguousarray(capture.read(frame, 1, [camera.name])[0, 0])
                container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
            container.mux(stream.encode(None))


def align(found: list[Camera], known: list[Camera]) -> dict[str, np.ndarray]:
    """Return rotation errors in degrees and position errors in percent of the rig's diameter.

    Source: Umeyama, Least-squares estimation of transformation parameters between two point patterns, 1991.
    """
    here, there = (np.stack([camera.center for camera in rig]).astype(np.float64) for rig in (found, known))
    a, b = here - here.mean(0), there - there.mean(0)
    turn, shrunk = nearest_rotation(b.T @ a)
    moved = np.linalg.norm(shrunk / (a**2).sum() * a @ turn.T - b, axis=1)
    size = np.linalg.norm(there[:, None] - there[None], axis=2).max()
    turns, theirs = (np.stack([camera.viewmat[:3, :3] for camera in rig]).astype(np.float64) for rig in (found, known))
    own, _ = nearest_rotation(np.einsum("nji,njk->ik", theirs, turns))
    return {
        "rotation_degrees": degrees(turns @ own.T, theirs),
        "by_centers_degrees": degrees(turns @ turn.T, theirs),
        "position_percent": 100 * moved / size,
    }


def nearest_rotation(matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the rotation R that makes the trace of R.T @ matrix the largest, and that trace."""
    U, S, Vt = np.linalg.svd(matrix)
    signs = np.array([1, 1, np.sign(np.linalg.det(U @ Vt))])
    return U @ np.diag(signs) @ Vt, float((S * signs).sum())


def degrees(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the angles between rotations [N, 3, 3]."""
    traces = np.einsum("nij,nij->n", one, other)
    return np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))


def neighbor_angle(cameras: list[Camera]) -> float:
    """Return the median angle in degrees between a camera and its nearest, seen from the point that all look at."""
    centers = np.stack([camera.center for camera in cameras]).astype(np.float64)
    axes = np.stack([camera.viewmat[2, :3] for camera in cameras]).astype(np.float64)
    across = np.eye(3) - axes[:, :, None] * axes[:, None]
    middle = np.linalg.solve(across.sum(0), np.einsum("nij,nj->i", across, centers))
    sights = centers - middle
    sights /= np.linalg.norm(sights, axis=1, keepdims=True)
    angles = np.degrees(np.arccos(np.clip(sights @ sights.T, -1, 1))) + 360 * np.eye(len(sights))
    return float(np.median(angles.min(1)))


def measure(capture: Capture, cameras: list[Camera], frames: list[int], learned: bool, same_lens: bool = False) -> dict:
    """Return the errors of a calibration of some cameras, or why there is none."""
    about = {"cameras": len(cameras), "neighbor_degrees": round(neighbor_angle(cameras), 1)}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_videos(capture, cameras, frames, folder)
        try:
            calibrate(folder, Silent(), matcher=find_matcher() if learned else None, same_lens=same_lens)
        except CaptureError as error:
            return {**about, "placed": 0, "refused": str(error).split(": ", 2)[-1].split(". ")[0]}
        with closing(open_capture(folder, held_out=[])) as placed:
            known = [capture.camera(camera.name) for camera in placed.cameras]
            errors = align(list(placed.cameras), known)
    found = {
        key: {"median": round(float(np.median(e)), 3), "max": round(float(e.max()), 3)} for key, e in errors.items()
    }
    return {**about, "placed": len(known), **found}


def make(name: str, path: Path, frames: int) -> Path:
    """Film the built-in capture, or a film of this folder, and return its folder."""
    if name == BUILT_IN:
        return make_capture(path / name, frames=frames)
    importlib.import_module(name).film().write(path / name, frames)
    return path / name


def main(
    name: tyro.conf.Positional[str],
    /,
    path: Path | None = None,
    frames: tuple[int, ...] = (0, 1, 2),
    cameras: tuple[int, ...] = (99, 8, 6, 4),
    same_lens: bool = False,
    learned: bool = True,
    note: str = "",
) -> None:
    """Measure and record.

    name: built-in, a film of this folder, or any name with `path`. path: capture with known cameras.
    cameras: sizes of the rig; rigs with fewer cameras are not thinned. same_lens: with the option --same-lens.
    learned: also with learned matches, where the rig is refused without them.
    """
    if learned and find_matcher() is None:
        raise SystemExit("Learned matches are not installed: pip install 'splatreel[match]'")
    with ExitStack() as stack:
        folder = path or make(name, Path(stack.enter_context(tempfile.TemporaryDirectory())), max(frames) + 1)
        source = stack.enter_context(closing(open_capture(folder, held_out=[])))
        for count in cameras:
            rig = thin(list(source.cameras), count)
            for matched in (False, True)[: 1 + learned]:
                found = measure(source, rig, list(frames), matched, same_lens)
                values = {"learned": matched, "same_lens": same_lens, "frames": list(frames), **found}
                print(values, flush=True)
                record(f"calibration {name}", values, note)
                if values["placed"]:  # then learned matches are not used
                    break


if __name__ == "__main__":
    tyro.cli(main)
