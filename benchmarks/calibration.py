"""Calibrate a capture with known cameras from a few of its frames, and record how far the poses are off.

The known poses are the truth, after a similarity alignment of the camera centers. Thinned rigs are the cameras that are
farthest from each other.

python benchmarks/calibration.py CAPTURE --name basketball --frames 0 30 59 --cameras 31 8 6 4 --learned
"""

import tempfile
from pathlib import Path

import av
import numpy as np
import tyro

from record import record
from splatreel.capture.base import Capture
from splatreel.capture.calibrate import calibrate
from splatreel.capture.learned_matches import find_describer
from splatreel.capture.opening import open_capture
from splatreel.errors import CaptureError
from splatreel.progress import Silent
from splatreel.scene.camera import Camera


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
                picture = np.ascontiguousarray(capture.read(frame, 1, [camera.name])[0, 0])
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            container.mux(stream.encode(None))


def align(found: list[Camera], known: list[Camera]) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation errors in degrees and the position errors as shares of the rig's diameter.

    Source: Umeyama, Least-squares estimation of transformation parameters between two point patterns, 1991.
    """
    here, there = (np.stack([camera.center for camera in rig]).astype(np.float64) for rig in (found, known))
    a, b = here - here.mean(0), there - there.mean(0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    signs = np.array([1, 1, np.sign(np.linalg.det(U @ Vt))])
    turn = U @ np.diag(signs) @ Vt
    moved = np.linalg.norm((S * signs).sum() / (a**2).sum() * a @ turn.T - b, axis=1)
    size = np.linalg.norm(there[:, None] - there[None], axis=2).max()
    traces = [np.trace(f.viewmat[:3, :3] @ turn.T @ k.viewmat[:3, :3].T) for f, k in zip(found, known, strict=True)]
    return np.degrees(np.arccos(np.clip((np.array(traces) - 1) / 2, -1, 1))), moved / size


def measure(capture: Capture, count: int, frames: list[int], learned: bool) -> dict:
    """Return the errors of a calibration of so many cameras, or why there is none."""
    cameras = thin(list(capture.cameras), count)
    describer = find_describer() if learned else None
    if learned and describer is None:
        raise SystemExit("Learned matches are not installed: pip install 'splatreel[match]'")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_videos(capture, cameras, frames, folder)
        try:
            calibrate(folder, Silent(), describer=describer)
        except CaptureError as error:
            return {"cameras": len(cameras), "placed": 0, "refused": str(error).split(": ", 2)[-1].split(". ")[0]}
        placed = open_capture(folder, held_out=[])
        known = [capture.camera(camera.name) for camera in placed.cameras]
        turned, moved = align(list(placed.cameras), known)
    errors = {"rotation_degrees": turned, "position_percent": 100 * moved}
    found = {
        key: {"median": round(float(np.median(e)), 3), "max": round(float(e.max()), 3)} for key, e in errors.items()
    }
    return {"cameras": len(cameras), "placed": len(known), **found}


def main(
    capture: tyro.conf.Positional[Path],
    /,
    name: str,
    frames: tuple[int, ...] = (0, 30, 59),
    cameras: tuple[int, ...] = (31, 8, 6, 4),
    learned: bool = False,
    note: str = "",
) -> None:
    """Measure and record. learned: with the extra `match`."""
    source = open_capture(capture, held_out=[])
    for count in cameras:
        values = {"learned": learned, "frames": list(frames), **measure(source, count, list(frames), learned)}
        print(values, flush=True)
        record(f"calibration {name}", values, note)


if __name__ == "__main__":
    tyro.cli(main)
