"""Search for the files of a sequence: one per frame, in a folder, in a folder per frame, or in a zip archive."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path, PurePosixPath

from splatreel.base.errors import GaussiansError
from splatreel.formats.registry import SOG_FOLDERS, SUFFIXES
from splatreel.formats.streamed_sog import LOD_META
from splatreel.importing.training_folders import check_is_frame, check_is_member_frame, is_mark

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
    """Return a name without its suffix."""
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
    """Return the folders of a training's iterations by number."""
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
