"""Recognition of training folders of dynamic methods, whose PLY file is not a frame: a network or a second file moves its points.

The names of files are those that the methods' own code writes. The table states the repository of each.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from glob import escape
from pathlib import Path, PurePath

from splatreel.base.errors import GaussiansError
from splatreel.formats.splat_columns import EXPORT

_ITERATION = re.compile(r"(coarse_)?iteration_\w+")
_OWN_FRAMES = "Run that method's export_perframe_3DGS.py, and import the folder that it writes."


@dataclass(frozen=True)
class _Mark:
    """A file that moves the points of a PLY file.

    Attributes:
        pattern: Path of the file, from the folder of the PLY file or from that of the model.
        method: Name of the method, and its repository.
        remedy: What to do instead.
    """

    pattern: str
    method: str
    remedy: str = EXPORT


_BESIDE = (
    _Mark("deformation.pth", "4DGaussians (hustvl/4DGaussians) or E-D3DGS (JeongminB/E-D3DGS)", _OWN_FRAMES),
    _Mark("dynamic_point_cloud.ply", "Ex4DGS (juno181/Ex4DGS)"),
    _Mark("posenet.pth", "SplineGS (KAIST-VICLab/SplineGS)"),
    _Mark("deform.pth", "Deformable-3D-Gaussians (ingra14m/Deformable-3D-Gaussians)"),
)
"""Files beside the PLY file."""
_IN_MODEL = (
    _Mark(
        "deform/iteration_*/deform.pth",
        "Deformable-3D-Gaussians (ingra14m/Deformable-3D-Gaussians) or a method built on it, such as SC-GS and Grid4D",
    ),
    _Mark("deform/deform.pth", "Deformable-3D-Gaussians (ingra14m/Deformable-3D-Gaussians)"),
    _Mark("NTC.pth", "3DGStream (SJoJoK/3DGStream)"),
)
"""Files in the folder of a model, which holds point_cloud/iteration_N/point_cloud.ply."""
_CHECKPOINTS = (
    ("checkpoints/last.ckpt", "Shape of Motion (vye16/shape-of-motion)"),
    ("*_d_model_*.pth", "MoSca (JiahuiLei/MoSca)"),
    ("**/nerfstudio_models/step-*.ckpt", "nerfstudio, such as 4D-Rotor-Gaussians (weify627/4D-Rotor-Gaussians)"),
    ("chkpnt*.pth", "3DGS's code, such as 4D Gaussian Splatting (fudan-zvg/4d-gaussian-splatting)"),
)
"""Checkpoints of trainings without a file of Gaussians, and who writes them."""


def check_is_frame(file: Path) -> None:
    """Raise `GaussiansError` if another file moves the points of a PLY file."""
    _check(file, lambda folder, pattern: Path(folder).glob(pattern), str(file))


def check_is_member_frame(name: PurePath, marks: Iterable[PurePath], archive: Path) -> None:
    """Raise `GaussiansError` if another member of an archive moves the points of a PLY file in it.

    Args:
        name: Name of the PLY file.
        marks: Names of the members of which `is_mark` is true.
        archive: The archive, for messages.
    """
    _check(
        name,
        lambda folder, pattern: (
            mark for mark in marks if mark.match(str(type(folder)(escape(str(folder))) / pattern))
        ),
        f"{archive}: {name}",
    )


def is_mark(name: PurePath) -> bool:
    """Return whether a file has the name of one that moves the points of another."""
    return any(name.name == PurePath(mark.pattern).name for mark in (*_BESIDE, *_IN_MODEL))


def check_no_checkpoint(folder: Path) -> None:
    """Raise `GaussiansError` if a folder without files of Gaussians holds the checkpoint of a training."""
    for pattern, method in _CHECKPOINTS:
        if found := next(iter(sorted(folder.glob(pattern))), None):
            raise GaussiansError(
                f"{found}: is the checkpoint of a training with {method}, which only its own program reads. {EXPORT}"
            )


Find = Callable[[PurePath, str], Iterable[PurePath]]
"""Search for the files below a folder whose path fits a pattern."""


def _check(file: PurePath, find: Find, subject: str) -> None:
    places: list[tuple[PurePath, tuple[_Mark, ...]]] = [(file.parent, _BESIDE)]
    model = _model_of(file)
    if model is not None:
        places.append((model, _IN_MODEL))
    for folder, marks in places:
        for mark in marks:
            if found := next(iter(sorted(other for other in find(folder, mark.pattern) if other != file)), None):
                raise GaussiansError(
                    f"{subject}: is not a frame, but part of a model of {mark.method}: {found} moves or adds points. {mark.remedy}"
                )


def _model_of(file: PurePath) -> PurePath | None:
    """Return the folder of the model that a training saved as point_cloud/iteration_N/point_cloud.ply."""
    for folder in list(file.parents)[:2]:  # 3DGStream adds the folder "added"
        if _ITERATION.fullmatch(folder.name) and folder.parent.name == "point_cloud":
            return folder.parent.parent
    return None
