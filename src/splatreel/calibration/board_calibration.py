"""Calibration of a rig by a board that is carried through the common view, for cameras that share no texture.

Each camera's lens is found by its own sightings. Frames in which two cameras see the board connect these. All sightings
together then refine lenses and poses. Either half of the frames must give the same cameras.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from splatreel.base.atomic import scratch
from splatreel.base.command_line import option, quoted
from splatreel.base.errors import CaptureError
from splatreel.base.progress import Progress
from splatreel.calibration.boards.board import Board
from splatreel.calibration.boards.board_rig import BoardRig, Views, adjust_rig, connect, place_boards, solve_camera
from splatreel.calibration.boards.board_sightings import Sightings, find_board
from splatreel.calibration.calibrate import move_into_place
from splatreel.calibration.calibration_agreement import CalibratedCamera, CalibratedRig, agreeing
from splatreel.calibration.uncalibrated import camera_files, open_uncalibrated, uncalibrated_files
from splatreel.capture.base import MIN_CAMERAS
from splatreel.capture.readers.colmap_model import import_pycolmap, write_model

FRAMES = 6
"""Minimum number of sightings of a camera."""
LINKS = 3
"""Minimum number of frames that connect two cameras."""
WORSE = 3.0
"""Maximum ratio between the error of a camera among the others and alone."""
EXACT = 0.5
"""Error in pixels that is never too large."""
COVERED = 0.5
"""Share of a camera's image that its sightings should cover. The distortion of the lens is uncertain beyond."""


@dataclass(frozen=True)
class BoardCalibration:
    """Result of a calibration by a board.

    Attributes:
        placed: Number of sightings by camera.
        lost: Cameras that come out elsewhere from either half of the frames.
        errors: Median reprojection error in pixels by camera.
        degrees: Largest angle between the poses of a camera from either half.
        meters: Largest distance between these poses.
        extent: Largest distance between two cameras in meters.
        notes: Sentences about what was chosen or converted in reading the videos.
    """

    placed: dict[str, int]
    lost: list[str]
    errors: dict[str, float]
    degrees: float
    meters: float
    extent: float
    notes: list[str]


def calibrate_by_board(
    path: Path,
    board: Board,
    progress: Progress,
    shown_in: Path | None = None,
    leave_out: Sequence[str] = (),
    record: dict[str, Any] | None = None,
) -> BoardCalibration:
    """Write the COLMAP model `sparse/0` of a folder of videos, in meters, by the sightings of a board.

    Args:
        path: Folder of videos.
        board: The board.
        progress: Progress display.
        shown_in: Folder of the videos that show the board, with the same names; by default the videos of `path`.
        leave_out: Names of videos that are not used.
        record: `calibration_record` of the command, to be written beside the model.

    Raises:
        CaptureError: The folder is calibrated already, a camera does not see the board often enough, frames do not connect
            all cameras, or the sightings contradict each other.
    """
    names = list(uncalibrated_files(path, leave_out))
    folder = path if shown_in is None else shown_in
    if not folder.is_dir():
        raise CaptureError(f"{folder}: is not a folder. Name the folder of the videos that show the board.")
    films = camera_files(folder, ())
    if absent := [name for name in names if name not in films]:
        raise CaptureError(
            f"{folder}: shows the board in no video of {', '.join(absent)}; there are {', '.join(films) or 'none'}. Name each video as "
            f"in {path}, or leave cameras out ({quoted(option('--leave-out', ','.join(absent)))})."
        )
    colmap = import_pycolmap()
    colmap.logging.minloglevel = colmap.logging.Level.FATAL.value
    videos = open_uncalibrated(folder, {name: films[name] for name in names})
    try:
        sightings = find_board(videos, names, board, progress)
        check_sightings(folder, board, names, sightings)
        sizes = {name: videos.size(name) for name in names}
        notes = [*videos.notes, *videos.conversions()]
    finally:
        videos.close()
    views = sightings.chosen({name: width for name, (width, _) in sizes.items()}).found
    progress.stage("placing the cameras", len(names) + 3)
    rig = _solve(colmap, folder, board, views, sizes, progress)
    halves = [_half(colmap, board, views, rig, remainder) for remainder in (0, 1)]
    found = _judged(folder, views, rig, halves, [*notes, *_uncovered(views, sizes)])
    with scratch(path, "calibrate") as temporary:
        _write_model(colmap, rig, list(found.placed), temporary / "model")
        move_into_place(temporary / "model", path, record)
    return found


def check_sightings(folder: Path, board: Board, names: Sequence[str], sightings: Sightings) -> None:
    """Raise `CaptureError` if a camera sees the board in too few frames."""
    few = {name: count for name in names if (count := len(sightings.of(name))) < FRAMES}
    if not few:
        return
    phrases: dict[str, list[str]] = {}
    for name, count in few.items():
        phrase = f"{count} frame{'s' if count > 1 else ''}" if count else "no frame"
        if others := sightings.others.get(name):
            phrase += f" (other frames show {others.most_common(1)[0][0]})"
        phrases.setdefault(phrase, []).append(name)
    found = "; ".join(f"{phrase} of {', '.join(cameras)}" for phrase, cameras in phrases.items())
    raise CaptureError(
        f"{folder}: each camera must show the board {board.spec} in {FRAMES} frames or more. It is in {found}. Check --board, hold the "
        f"board closer and tilted to all sides, or leave cameras out ({quoted(option('--leave-out', ','.join(few)))})."
    )


def _solve(
    colmap: ModuleType, folder: Path, board: Board, views: Views, sizes: dict[str, tuple[int, int]], progress: Progress
) -> BoardRig:
    """Return the cameras by all sightings. Raise `CaptureError` if they are not connected, or contradict each other."""
    alone = {}
    for count, (name, size) in enumerate(sizes.items(), 1):
        seen = {frame: found[name] for frame, found in views.items() if name in found}
        alone[name] = solve_camera(colmap, board, name, seen, size)
        progress.update(count)
    boards = {name: found.boards for name, found in alone.items()}
    poses, groups = connect(views, boards, LINKS)
    if len(groups) > 1:
        raise CaptureError(
            f"{folder}: the cameras are in {len(groups)} groups that no {LINKS} frames connect: "
            f"{' | '.join(', '.join(sorted(group)) for group in groups)}. Carry the board also where cameras of two groups see "
            f"it at the same time, or leave cameras out (--leave-out)."
        )
    lenses = {name: found.lenses[name] for name, found in alone.items()}
    start = BoardRig(lenses, poses, place_boards(board, views, lenses, poses, boards), {})
    rig = adjust_rig(colmap, board, views, start)
    progress.update(len(sizes) + 1)
    off = [name for name in sizes if rig.errors[name] > max(WORSE * alone[name].errors[name], EXACT)]
    if off:
        name = max(off, key=lambda name: rig.errors[name])
        raise CaptureError(
            f"{folder}: the cameras contradict each other: {name} sees the board {rig.errors[name]:.1f} pixels from where all "
            f"cameras place it, and {alone[name].errors[name]:.1f} pixels from where it does so alone. Run `splatreel capture sync` on "
            f"these videos if they do not start together, hold the board still at each place, and do not move the cameras."
        )
    return rig


def _half(colmap: ModuleType, board: Board, views: Views, rig: BoardRig, remainder: int) -> BoardRig:
    """Return the cameras by every other frame."""
    some = {frame: seen for number, (frame, seen) in enumerate(views.items()) if number % 2 == remainder}
    return adjust_rig(colmap, board, some, rig)


def _judged(folder: Path, views: Views, rig: BoardRig, halves: list[BoardRig], notes: list[str]) -> BoardCalibration:
    """Return the cameras on which both halves agree. Raise `CaptureError` if these are too few."""
    counts = {name: sum(name in seen for seen in views.values()) for name in rig.poses}
    whole, *parts = (_rig(found, counts) for found in (rig, *halves))
    kept = [name for name in rig.poses if all(name in agreeing(whole, part) for part in parts)]
    if len(kept) < MIN_CAMERAS:
        raise CaptureError(
            f"{folder}: either half of the frames places the cameras elsewhere; {len(kept)} of {len(counts)} agree. Show the board "
            f"longer: near and far, in all corners of each image, and tilted to all sides."
        )
    one, other = parts
    turned = [Rotation.from_matrix(one[name].rotation @ other[name].rotation.T).magnitude() for name in kept]
    moved = [np.linalg.norm(one[name].center - other[name].center) for name in kept]
    centers = np.stack([whole[name].center for name in kept])
    extent = np.linalg.norm(centers[:, None] - centers[None], axis=2).max()
    placed, lost = {name: counts[name] for name in sorted(kept)}, sorted(set(counts) - set(kept))
    degrees = float(np.degrees(max(turned)))
    return BoardCalibration(placed, lost, rig.errors, degrees, float(max(moved)), float(extent), notes)


def _uncovered(views: Views, sizes: dict[str, tuple[int, int]]) -> list[str]:
    """Return a sentence about cameras of whose images the board covered little."""
    little = []
    for name, (width, height) in sizes.items():
        places = np.concatenate([seen[name].places for seen in views.values() if name in seen])
        share = ConvexHull(places).volume / (width * height)
        if share < COVERED:
            little.append(f"{name} ({share:.0%})")
    if not little:
        return []
    return [f"lenses are uncertain beyond the part of the image in which the board was: {', '.join(little)}"]


def _rig(found: BoardRig, counts: dict[str, int]) -> CalibratedRig:
    rig = {}
    for name, pose in found.poses.items():
        lens = found.lenses[name]
        focal = lens.mean_focal_length() / max(lens.width, lens.height)
        rig[name] = CalibratedCamera(pose[:, :3], -pose[:, :3].T @ pose[:, 3], focal, counts[name])
    return rig


def _write_model(colmap: ModuleType, rig: BoardRig, names: list[str], folder: Path) -> None:
    """Write a COLMAP model of some cameras, without points, since the board is not part of the scene."""
    model = colmap.Reconstruction()
    for number, name in enumerate(names, 1):
        lens: Any = rig.lenses[name]
        lens.camera_id = number
        model.add_camera_with_trivial_rig(lens)
        image = colmap.Image(name=f"{name}.png", camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, colmap.Rigid3d(rig.poses[name]))
    write_model(model, folder)
