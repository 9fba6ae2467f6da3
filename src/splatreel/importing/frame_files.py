"""Files of frames: finding them, the order of their names, and training folders, whose files are not frames."""

from __future__ import annotations

import math
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from glob import escape
from itertools import pairwise
from pathlib import Path, PurePath, PurePosixPath
from typing import Literal

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.formats.registry import SOG_FOLDERS, SUFFIXES
from splatreel.formats.splat_columns import EXPORT
from splatreel.formats.streamed_sog import LOD_META

_TRAINED_ITERATION = re.compile(r"(coarse_)?iteration_\w+")
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
        if _TRAINED_ITERATION.fullmatch(folder.name) and folder.parent.name == "point_cloud":
            return folder.parent.parent
    return None


Gaps = Literal["refuse", "hold"]
"""Treatment of missing frame numbers: refuse the sequence, or hold the previous frame."""
MOST_FRAMES = 1_000_000
"""Maximum number of frames, including held ones."""
MOST_DIGITS = 18
"""Maximum digits of a number that counts frames, which fits into 64 bits."""
SECONDS = 0.1, 1000.0
"""Frame rates at which numbers with a decimal point are seconds."""
COMMON_RATES = (15, 24000 / 1001, 24, 25, 30000 / 1001, 30, 48, 50, 60000 / 1001, 60, 90, 100, 120, 240)
TICK = 10
"""Numbers at least this far apart may be times in some unit, whose steps differ by rounding."""
ROUNDING = 0.2
"""Maximum deviation of such a step from a multiple of the usual step, as a share of it."""


@dataclass(frozen=True)
class Order:
    """Frames in order.

    Attributes:
        names: Names by frame; a held frame repeats the name before it.
        fps: Frames per second, if the names hold seconds.
        step: Difference of the numbers of consecutive frames.
    """

    names: list[str]
    fps: float | None = None
    step: float = 1.0


def order_frames(names: Sequence[str], place: str, gaps: Gaps) -> Order:
    """Sort names by the number that differs between them, which may stand anywhere and may be a time in seconds.

    Args:
        names: Names without suffixes, one per frame.
        place: Folder or archive, for messages.
        gaps: Treatment of missing numbers.

    Raises:
        GaussiansError: The order is unclear, or frames are missing and `gaps` is "refuse".
    """
    if len(names) == 1:
        return Order(list(names))
    fields = {name: re.findall(r"[0-9]+", name) for name in names}
    _check_alike(fields, place)
    columns = list(zip(*fields.values(), strict=True))
    varying = [i for i, column in enumerate(columns) if len({number.lstrip("0") for number in column}) > 1]
    times = _seconds(fields, varying)
    if times is not None:
        return _by_time(times, place, gaps)
    if not varying:
        raise GaussiansError(f"{place}: holds frame {columns[-1][0].lstrip('0') or '0':.40} twice. Remove one of them.")
    _check_lengths(columns, varying, place)
    chosen = _choose_field(columns, varying, place, next(iter(names)))
    numbers = {name: int(numbers[chosen]) for name, numbers in fields.items()}
    return _without_gaps(numbers, place, gaps)


def _check_alike(fields: dict[str, list[str]], place: str) -> None:
    bare = next((name for name, numbers in fields.items() if not numbers), None)
    if bare is not None:
        raise GaussiansError(
            f"{place}: the name {bare} has no number that says which frame it is. Remove the file, or number it."
        )
    shapes = Counter(re.sub(r"[0-9]+", "N", name) for name in fields)
    if len(shapes) > 1:
        (usual, _), *_, (odd, _) = shapes.most_common()
        raise GaussiansError(
            f"{place}: holds files called {usual} and files called {odd}. Put each sequence into its own folder."
        )


def _check_lengths(columns: list[tuple[str, ...]], varying: list[int], place: str) -> None:
    long = next((word for i in varying for word in columns[i] if len(word.lstrip("0")) > MOST_DIGITS), None)
    if long is not None:
        raise GaussiansError(
            f"{place}: the number {long:.40} in a name has more than {MOST_DIGITS} digits, expected one that counts frames. Rename "
            "the files."
        )


def _choose_field(columns: list[tuple[str, ...]], varying: list[int], place: str, example: str) -> int:
    """Return the field that numbers the frames. Several fields may vary if they give the same order."""
    values = [np.array([int(number) for number in columns[i]], np.int64) for i in varying]
    orders = {tuple(np.argsort(value, kind="stable").tolist()) for value in values}
    unique = [i for i, value in zip(varying, values, strict=True) if len(np.unique(value)) == len(value)]
    if len(varying) > 1 and (len(orders) > 1 or not unique):
        raise GaussiansError(
            f"{place}: names such as {example} hold {len(varying)} numbers that differ between files, so the order is unclear. Keep "
            "one number that counts frames, and put each sequence into its own folder."
        )
    if not unique:
        counts = Counter(map(int, columns[varying[0]]))
        raise GaussiansError(f"{place}: holds frame {counts.most_common(1)[0][0]} twice. Remove one of them.")
    return min(unique, key=lambda i: np.ptp([int(number) for number in columns[i]]))


def _seconds(fields: dict[str, list[str]], varying: list[int]) -> dict[str, float] | None:
    """Return times by name if the varying numbers are seconds with a decimal point, otherwise None."""
    example = next(iter(fields))
    separators = re.split(r"[0-9]+", example)[1:-1]
    decimals = [i for i, separator in enumerate(separators) if separator == "." and {i, i + 1} & set(varying)]
    if len(decimals) != 1 or not set(varying) <= {decimals[0], decimals[0] + 1}:
        return None
    whole = decimals[0]
    if max(len(numbers[whole]) for numbers in fields.values()) > MOST_DIGITS:
        return None
    if whole not in varying and int(fields[example][whole]) != 0:
        return None
    times = {name: float(f"{numbers[whole]}.{numbers[whole + 1]}") for name, numbers in fields.items()}
    steps = np.diff(np.sort(list(times.values())))
    if steps.min() <= 0 or not SECONDS[0] <= 1 / _usual_step(steps) <= SECONDS[1]:
        return None
    return times


def _usual_step(steps: np.ndarray) -> float:
    """Return the step between consecutive frames: the mean of the shortest ones, which rounding makes differ a little."""
    return float(np.mean(steps[steps <= (1 + 2 * ROUNDING) * steps.min()]))


def _by_time(times: dict[str, float], place: str, gaps: Gaps) -> Order:
    ordered = sorted(times, key=lambda name: times[name])
    values = np.array([times[name] for name in ordered])
    step = _usual_step(np.diff(values))
    counts = np.maximum(np.rint(np.diff(values) / step), 1)
    odd = np.abs(np.diff(values) / step - counts) > ROUNDING * counts
    if odd.any():
        first = int(odd.argmax())
        raise GaussiansError(
            f"{place}: the times in the names are not evenly spaced: {ordered[first]} and {ordered[first + 1]} are "
            f"{values[first + 1] - values[first]:.3g} s apart, others {step:.3g} s. Export frames at a constant rate."
        )
    rate = float(counts.sum() / (values[-1] - values[0]))
    near = min(COMMON_RATES, key=lambda common: abs(common - rate))
    rate = near if abs(near - rate) < 0.005 * rate else round(rate, 3)
    numbers = np.concatenate([[0], np.cumsum(counts)]).astype(int)
    order = _without_gaps(dict(zip(ordered, numbers.tolist(), strict=True)), place, gaps)
    return Order(order.names, rate)


def _without_gaps(numbers: dict[str, int], place: str, gaps: Gaps) -> Order:
    """Order names by number, with the previous name repeated for each missing number. A constant step is not a gap."""
    names = sorted(numbers, key=lambda name: numbers[name])
    steps = [numbers[after] - numbers[before] for before, after in pairwise(names)]
    if len(set(steps)) <= 1:
        return Order(names, step=steps[0])
    step = float(math.gcd(*steps))
    usual = _usual_step(np.array(steps))
    multiples = np.array(steps) / usual
    if usual >= TICK and np.abs(multiples - np.maximum(np.rint(multiples), 1)).max() <= ROUNDING:
        step = usual
    lengths = [round(length / step) for length in steps]
    missing = sum(lengths) - len(lengths)
    if not missing:
        return Order(names, step=step)
    first = next(i for i, length in enumerate(lengths) if length > 1)
    count = f"{missing:,} frames are" if missing > 1 else "1 frame is"
    if gaps != "hold":
        raise GaussiansError(
            f"{place}: {count} missing, the first after {names[first]}: the next one is "
            f"{names[first + 1]}. Add them, or import with --gaps hold, which repeats the previous frame."
        )
    if len(names) + missing > MOST_FRAMES:
        raise GaussiansError(
            f"{place}: with {missing:,} frames held it would have more than {MOST_FRAMES:,}. Renumber its files."
        )
    return Order([name for name, length in zip(names, [*lengths, 1], strict=True) for _ in range(length)], step=step)


_ITERATION = re.compile(r"iteration_([0-9]+)")
TILESET = "tileset.json"
"""Description of a set of 3D Tiles."""


def find_files(place: Path) -> dict[str, Path]:
    """Return the file of each frame by the name that numbers it. The result is empty if there are none.

    Args:
        place: A file of Gaussians, or a folder of a sequence.

    Raises:
        GaussiansError: A frame's file is missing, or the choice is unclear.
    """
    found = _find(place)
    for file in {file.parent: file for file in found.values() if file.suffix.lower() == ".ply"}.values():
        check_is_frame(file)
    return found


def _find(place: Path) -> dict[str, Path]:
    if place.is_file():
        return {place.stem: place} if place.suffix.lower() in SUFFIXES or place.name in SOG_FOLDERS else {}
    if (model := place / "point_cloud").is_dir() and _iterations(model):
        return {place.name: _only_file(model)}
    if _iterations(place):
        return {place.name: _only_file(place)}
    if (scene := _sog_in(place)) is not None:
        return {place.name: scene}
    if (place / TILESET).is_file():
        raise GaussiansError(
            f"{place / TILESET}: is a set of 3D Tiles, whose files are parts of one scene and no frames. Convert it to PLY."
        )
    entries = [entry for entry in sorted(place.iterdir()) if not entry.name.startswith(".")]
    files = [entry for entry in entries if entry.suffix.lower() in SUFFIXES]
    _check_suffixes([file.name for file in files], str(place))
    if files:
        _check_files(files)
        return {_stem(file.name): file for file in files}
    numbered = [entry for entry in entries if re.search(r"[0-9]", entry.name) and not entry.is_file()]
    folders = [entry for entry in numbered if entry.is_dir()]
    if folders:
        if odd := next((entry for entry in numbered if not entry.is_dir()), None):
            raise _not_a_file_error(odd)
        return {folder.name: _only_file(folder) for folder in folders}
    return {}


def find_members(place: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Return the member of a zip archive that holds each frame, by its path without the suffix.

    Raises:
        GaussiansError: The archive is encrypted, or holds files of several kinds.
    """
    members = {}
    names = [PurePosixPath(info.filename) for info in archive.infolist()]
    if scene := next((name for name in names if name.name in (LOD_META, TILESET)), None):
        raise GaussiansError(
            f"{place}: {scene} describes parts of one scene, which are not frames. Unpack the archive."
        )
    models = [name for name in names if is_mark(name)]
    for info in archive.infolist():
        name = PurePosixPath(info.filename)
        hidden = any(part.startswith(".") or part == "__MACOSX" for part in name.parts)
        if not info.is_dir() and not hidden and name.suffix.lower() in SUFFIXES:
            if info.flag_bits & 1:
                raise GaussiansError(f"{place}: {info.filename} is encrypted. Pack it without a password.")
            if name.suffix.lower() == ".ply":
                check_is_member_frame(name, models, place)
            members[_stem(info.filename)] = info
    _check_suffixes([info.filename for info in members.values()], str(place))
    return members


def _stem(name: str) -> str:
    return name[: len(name) - len(PurePosixPath(name).suffix)]


def _check_suffixes(names: list[str], place: str) -> None:
    kinds = sorted({PurePosixPath(name).suffix.lower() for name in names})
    if len(kinds) > 1:
        raise GaussiansError(f"{place}: holds {' and '.join(kinds)} files. Put each sequence into its own folder.")


def _check_files(files: list[Path]) -> None:
    if odd := next((file for file in files if not file.is_file()), None):
        raise _not_a_file_error(odd)


def _not_a_file_error(path: Path) -> GaussiansError:
    what = "a link to nothing" if path.is_symlink() and not path.exists() else "no file"
    return GaussiansError(f"{path}: is {what}, so a frame is missing. Add the file, or remove the entry.")


def _sog_in(folder: Path) -> Path | None:
    """Return the file that describes the streamed or unpacked SOG file in a folder; None if there is none."""
    found = next((folder / name for name in SOG_FOLDERS if (folder / name).is_file()), None)
    return found if found is None or found.name == LOD_META or any(folder.glob("*.webp")) else None


def _iterations(folder: Path) -> dict[int, Path]:
    found = ((_ITERATION.fullmatch(entry.name), entry) for entry in folder.iterdir())
    return {int(match[1]): entry for match, entry in found if match and entry.is_dir()}


def _only_file(folder: Path) -> Path:
    """Return the file of a frame's folder, the newest iteration if there are several.

    Raises:
        GaussiansError: There is no file, or the choice is unclear.
    """
    if (scene := _sog_in(folder)) is not None:
        return scene
    found = [
        file
        for file in sorted(folder.rglob("*"))
        if file.suffix.lower() in SUFFIXES
        and file.is_file()
        and not any(part.startswith(".") for part in file.relative_to(folder).parts)
    ]
    models = [file for file in found if _ITERATION.fullmatch(file.parent.name)]
    if len(found) > 1 and models:
        newest = max(int(file.parent.name.partition("_")[2]) for file in models)
        found = [file for file in models if int(file.parent.name.partition("_")[2]) == newest]
    if len(found) > 1 and any(file.name == "point_cloud.ply" for file in found):
        for file in found:
            check_is_frame(file)
    if len(found) != 1:
        raise GaussiansError(f"{folder}: holds {len(found)} files of Gaussians, where a frame's folder has one.")
    return found[0]
