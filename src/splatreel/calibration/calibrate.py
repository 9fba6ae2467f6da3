"""Calibration of the cameras of a folder of videos: COLMAP models of several moments, by pycolmap.

Moments are solved independently, and only poses on which they agree are kept: with too few matches COLMAP returns wrong
poses without an error. Photographs of a camera that is walked between the views connect distant cameras. They are
solved with every moment and left out of the result. Then all moments together refine the poses and lenses
(`rig_refinement.py`) and place further cameras (`resection.py`). If all this fails, the moments are solved by learned matches, if the
extra `match` is installed.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from splatreel.base.atomic import move, scratch
from splatreel.base.child_process import ChildEndedError, Send, run_in_child
from splatreel.base.command_line import quoted
from splatreel.base.errors import CaptureError
from splatreel.base.progress import Progress, Span
from splatreel.calibration.board import Board
from splatreel.calibration.board_sightings import board_scale, find_board
from splatreel.calibration.calibration_agreement import (
    FIELD,
    ONE_LENS_ZOOMED,
    ZOOMED,
    CalibratedRig,
    rig_of,
    trusted,
    unanimous,
)
from splatreel.calibration.calibration_files import (
    MODEL,
    PHOTO_FOLDER,
    CameraFiles,
    check_photos,
    open_uncalibrated,
    uncalibrated_files,
    write_record,
)
from splatreel.calibration.learned_matches import INSTALL, Matcher
from splatreel.calibration.moment_solver import MomentSolver
from splatreel.calibration.resection import MatchedFeatures, place_lost
from splatreel.calibration.rig_refinement import refine_by_moments, refine_lenses
from splatreel.capture.base import MIN_CAMERAS
from splatreel.capture.file_capture import FrameSource
from splatreel.capture.readers.colmap_model import import_pycolmap, require_pycolmap, write_model
from splatreel.capture.sidecar import write_failure

Distance = tuple[str, str, float]
"""Two cameras, and the distance of their lenses in meters."""
FEW = 100
"""Number of visible points below which a camera's pose and lens are doubtful."""


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration.

    Attributes:
        placed: Number of visible points by camera.
        lost: Cameras that could not be placed, or not consistently.
        error: Mean reprojection error in pixels.
        moments: Number of solved moments.
        notes: Sentences about what was chosen or converted in reading the videos.
    """

    placed: dict[str, int]
    lost: list[str]
    error: float
    moments: int
    notes: list[str]

    @property
    def doubtful(self) -> list[str]:
        """Cameras whose pose may be wrong."""
        return [name for name, points in self.placed.items() if points < FEW]


def calibrate(
    path: Path,
    progress: Progress,
    also: Path | None = None,
    leave_out: Sequence[str] = (),
    matcher: Matcher | None = None,
    scale: Distance | Board | None = None,
    same_lens: bool = False,
    record: dict[str, Any] | None = None,
) -> Calibration:
    """Write the COLMAP model `sparse/0` of a folder of videos or folders of images, one per camera, from frames spread over them.

    Cameras with too few matches, or on which moments disagree, are left out.

    Args:
        path: Folder of videos, or of folders of images.
        progress: Progress display.
        also: Folder of photographs that connect the cameras' views.
        leave_out: Names of videos that are not used.
        matcher: Network of `find_matcher`, which is asked if COLMAP's own features place no cameras.
        scale: Known distance of two cameras, or a board that the videos show, which makes the world's unit a meter.
        same_lens: True if all cameras have the same lens and zoom. Then fewer matches place them.
        record: `calibration_record` of the command, to be written beside the model.

    Raises:
        CaptureError: The folder is calibrated already, has too few cameras, lacks a camera of `scale`, or fewer than
            three cameras could be placed reliably. The last case is recorded in the folder's `splatreel.json`.
    """
    files = uncalibrated_files(path, leave_out)
    if isinstance(scale, tuple):
        check_distance(scale, path, files)
    photos = check_photos(also) if also is not None else []
    require_pycolmap()
    with scratch(path, "calibrate") as folder:
        try:
            found = run_in_child(
                *(_place, path, files, photos, folder, matcher, scale, same_lens),
                on_message=lambda message: _call_progress(progress, *message),
            )
        except ChildEndedError as error:
            raise CaptureError(
                f"{path}: COLMAP's process was ended {error.how}. If memory ran out (SIGKILL), close other programs; then try again."
            ) from error
        if isinstance(found, str):
            write_failure(path, found)
            raise CaptureError(f"{path}: the calibration failed, and nothing was kept of it: {found}")
        move_into_place(folder / "model", path, record)
    return found


def move_into_place(made: Path, path: Path, record: dict[str, Any] | None) -> None:
    """Move a model into a capture, with its record, completely or not at all, and forget that a calibration failed."""
    if record is not None:
        write_record(made, record)
    place = path / MODEL
    place.parent.mkdir(exist_ok=True)
    shutil.rmtree(place, ignore_errors=True)
    move(made, place)
    write_failure(path, None)


def _place(
    send: Send,
    path: Path,
    files: CameraFiles,
    photos: list[Path],
    folder: Path,
    matcher: Matcher | None,
    scale: Distance | Board | None,
    same_lens: bool,
) -> Calibration | str:
    """Place the cameras in a child process, because COLMAP computes for minutes without handling signals.

    The model is left in folder / "model".

    Returns:
        The calibration, or the reason why there is no reliable model.
    """
    colmap, progress = import_pycolmap(), _ProgressSender(send)
    colmap.logging.minloglevel = colmap.logging.Level.FATAL.value
    videos = open_uncalibrated(path, files)
    try:
        if same_lens:
            check_same_size(videos, list(files))
        placed: _Placed | str = ""
        for number, way in enumerate([None] if matcher is None or photos else [None, matcher]):
            solver = MomentSolver(colmap, folder / f"way{number}", progress, same_lens, photos, way)
            placed = _solve(colmap, solver, videos, list(files))
            if not isinstance(placed, str):
                break
        if isinstance(placed, str):
            return placed if matcher is not None or photos else f"{placed} {INSTALL}"
        model, kept = placed.model, set(placed.points)
        if isinstance(scale, Board):
            views = {Path(image.name).stem: image for image in map(model.image, model.reg_image_ids())}
            found = board_scale(views, scale, find_board(videos, sorted(views), scale, progress))
            if isinstance(found, str):
                return found
            _scale_model(colmap, model, found)
        notes = [*videos.notes, *videos.conversions()]
    finally:
        videos.close()
    if isinstance(scale, tuple) and (unsure := {*scale[:2]} - kept):
        return f"{' and '.join(sorted(unsure))} could not be placed, whose distance is given. Give that of two others."
    if isinstance(scale, tuple):
        set_distance(colmap, model, scale)
    write_model(model, folder / "model")
    points = {name: placed.points[name] for name in sorted(kept)}
    error = float(model.compute_mean_reprojection_error())
    return Calibration(points, sorted(set(files) - kept), error, placed.moments, notes)


@dataclass(frozen=True)
class _Placed:
    """Model of the cameras that could be placed."""

    model: Any
    points: dict[str, int]
    moments: int


def _solve(colmap: ModuleType, solver: MomentSolver, videos: FrameSource, names: list[str]) -> _Placed | str:
    """Return the refined model of the cameras on which moments agree, or the reason why there is none."""
    models = solver.solve(videos, names)
    rigs = [rig_of(model) for model in models]
    zoom = ONE_LENS_ZOOMED if solver.one_lens else ZOOMED
    best, kept = trusted(rigs, FEW, zoom) if rigs else (0, set[str]())
    sure = [name for name in kept if rigs[best][name].points >= FEW]
    if solver.matcher is not None and len(kept := unanimous(rigs)) < max(map(len, rigs), default=0):
        return _explain_failure(names, rigs, kept, MIN_CAMERAS)  # repeated patterns mislead learned matches
    if len(sure) < MIN_CAMERAS or 2 * len(kept) < len(rigs[best]):
        return _explain_failure(names, rigs, kept, len(sure))
    refine_lenses(colmap, models[best])  # with the photographs, which may be all that connects the cameras
    model = _keep_cameras(models[best], kept)
    points = {name: rigs[best][name].points for name in kept}
    if not solver.photos:
        model = refine_by_moments(colmap, model, models, solver.folder)
    if not solver.photos and solver.matcher is None:
        added = place_lost(colmap, model, rigs, MatchedFeatures(colmap, solver.databases), FEW)
        if added:
            refine_lenses(colmap, model)
        points |= added
    return _Placed(model, points, len(models))


class _ProgressSender:
    """Progress that is sent to the parent process as arguments of `_show`."""

    def __init__(self, send: Send) -> None:
        self._send = send

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        self._send(("stage", (name, total, span), {}))

    def update(self, done: int, **numbers: float) -> None:
        self._send(("update", (done,), numbers))

    def note(self, text: str) -> None:
        self._send(("note", (text,), {}))


def _call_progress(progress: Progress, method: str, arguments: tuple[Any, ...], numbers: dict[str, float]) -> None:
    """Call the progress method that `_Sent` received in the child process."""
    getattr(progress, method)(*arguments, **numbers)


def _explain_failure(names: list[str], rigs: list[CalibratedRig], kept: set[str], sure: int) -> str:
    most = max(rigs, key=len, default={})
    odd = {name: placed for rig in rigs for name, placed in rig.items() if not placed.possible}
    if len(most) < MIN_CAMERAS:
        placed = f"only {len(most)} of {len(names)} cameras ({', '.join(sorted(most)) or 'none'}) show enough in common to tell"
        why = f"{placed} where they stand"
    elif odd:
        name = min(odd)
        lens = f"a lens that shows {odd[name].field:.3g} degrees, and no lens shows less than {FIELD[0]:g} or more than {FIELD[1]:g}"
        why = f"{name} would have {lens}"
    elif len(kept) >= MIN_CAMERAS > sure:
        why = f"only {sure} of {len(names)} cameras see {FEW} points or more, too few to be sure of any"
    elif len(rigs) > 1:
        why = f"at different moments of the videos the cameras come out elsewhere; {len(kept)} of {len(names)} agree"
    else:
        why = f"only {len(kept)} of {len(names)} cameras see enough to be sure of them, {FEW} points"
    return (
        f"{why}. The cameras are too far apart, or see too little texture. If all have the same lens and zoom, try --same-lens. "
        f"Or take some twenty photographs on a walk from each camera's view to the next, each of which shows much of what the one "
        f"before does, and give their folder: splatreel capture calibrate --also PHOTOS. Or carry a board through the view (--board "
        f"5x7:0.035), or film with cameras closer together."
    )


def check_distance(distance: Distance, path: Path, names: Iterable[str]) -> None:
    """Raise `CaptureError` unless a distance is positive and its cameras are different cameras of the folder."""
    one, other, meters = distance
    unknown = [name for name in (one, other) if name not in names]
    if unknown:
        raise CaptureError(
            f"{path}: has no camera {unknown[0]}, whose distance is given; there are {', '.join(names)}."
        )
    if one == other or not (math.isfinite(meters) and meters > 0):
        raise CaptureError(
            f"the distance {one} {other} {meters:g} is not one of two cameras in meters. Give it as: "
            f"{quoted(['--distance', one, 'OTHER', 2.5])}"
        )


def check_same_size(source: FrameSource, names: Sequence[str]) -> None:
    """Raise `CaptureError` if cameras that should have the same lens have frames of different sizes."""
    sizes = {name: source.size(name) for name in names}
    first = names[0]
    for name, size in sizes.items():
        if size != sizes[first]:
            raise CaptureError(
                f"{name} has frames of {size[0]}x{size[1]} pixels, {first} of {sizes[first][0]}x{sizes[first][1]}. Their lenses "
                f"differ in pixels: leave out --same-lens, or make the sizes equal."
            )


def set_distance(colmap: ModuleType, model: Any, distance: Distance) -> None:
    """Scale a model so that two of its cameras have a known distance."""
    rig, (one, other, meters) = rig_of(model), distance
    found = float(np.linalg.norm(rig[one].center - rig[other].center))
    _scale_model(colmap, model, meters / found)


def _scale_model(colmap: ModuleType, model: Any, factor: float) -> None:
    model.transform(colmap.Sim3d(factor, colmap.Rotation3d(np.eye(3)), np.zeros(3)))


def _keep_cameras(model: Any, kept: set[str]) -> Any:
    for number in list(model.reg_image_ids()):
        image = model.image(number)
        if image.name.startswith(PHOTO_FOLDER) or Path(image.name).stem not in kept:
            model.deregister_frame(image.frame_id)
    model.tear_down()
    return model
