"""Pairing of calibrated cameras with the videos or image folders of a capture, by name."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import takewhile
from pathlib import Path
from typing import Any

from splatreel.base.command_line import quoted
from splatreel.base.errors import CaptureError
from splatreel.base.progress import listed
from splatreel.capture.files import list_folder
from splatreel.capture.image_sequences import IMAGE_SUFFIXES, flat_images, image_files
from splatreel.capture.segmented_video import segment_files
from splatreel.capture.video import VIDEO_SUFFIXES

PREFERRED = ("synchronized_videos", "videos-sync", "videos", "hdVideos", ".", "images", "hdImgs")
"""Folders of a capture that are read before others, in this order."""
SKIPPED = re.compile(r"(.*_)?calib.*|intrinsics?|extrinsics?|.*annotated.*|masks?|depths?", re.IGNORECASE)
"""Folders whose videos and images are not those of the scene."""
SHARED = ("calibration/extrinsic",)
"""Folders that are read if no other fits: all cameras film the target at the same time there."""
DEPTH = 3
"""Levels of folders below the capture that are searched."""
WORD = re.compile(r"\d+|[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
"""Part of a name: a number, or a word of which several may follow each other, as in camA."""
SERIAL = re.compile(r"\d{4,}$")
"""Serial number of a camera, as in take_Miqus_1_26580."""
KINDS = ("videos", "folders of videos", "folders of images", "images")
"""Kinds of media, the preferred first."""

Media = Mapping[str, Path] | Mapping[str, Sequence[Path | None]]
"""Video, or images in order of time, by camera. A camera may lack images."""


@dataclass(frozen=True)
class _Group:
    """Media of one kind in one folder, by their own names."""

    folder: Path
    kind: str
    files: Media

    def rank(self, path: Path) -> int:
        """Return the place in the order of preference."""
        name = self.folder.relative_to(path).as_posix()
        return PREFERRED.index(name) if name in PREFERRED else len(PREFERRED) + (name in SHARED)

    @property
    def recording(self) -> Path:
        """Folder of the recording: of NAME/videos it is NAME."""
        return self.folder.parent if self.folder.name in PREFERRED else self.folder

    def is_part_of(self, other: _Group) -> bool:
        """Return True if another folder has the videos of the same recording, and this one has copies, such as annotated ones."""
        return self.folder != other.folder and (
            other.folder in self.folder.parents
            or (self.recording != other.recording and other.recording in self.folder.parents)
            or (self.recording == other.recording and self._place > other._place)
        )

    @property
    def _place(self) -> int:
        return PREFERRED.index(self.folder.name) if self.folder.name in PREFERRED else len(PREFERRED)


def find_media(path: Path, names: list[str], origin: Path, partial: bool = False) -> Media:
    """Return the video or the images of each camera.

    Videos take precedence over image folders, and these over one image per camera. If no names are equal, they may differ in case, file
    extension, leading zeros, and in words that all cameras or all videos have in common: `hd_00_05.mp4` is of camera
    `00_05`, and `Camera_001_synchronized.mp4` of `cam_1`. A serial number at the end of a name is enough.

    Args:
        path: Folder of the capture.
        names: Names of the cameras.
        origin: Calibration, for messages.
        partial: Leave out cameras without media. Otherwise they are an error.

    Raises:
        CaptureError: No folder has media for the cameras, or several have.
    """
    groups = list(_groups(path))
    for simplify in SIMPLER:
        for kind in KINDS:
            found = [(g, pairs) for g in groups if g.kind == kind and (pairs := _pairs(names, g, simplify, partial))]
            found.sort(key=lambda fit: (fit[0].rank(path), str(fit[0].folder)))
            usual = [g for g, _ in found if g.rank(path) == len(PREFERRED)]
            usual = [g for g in usual if not any(g.is_part_of(other) for other in usual)]
            if usual and found[0][0].rank(path) == len(PREFERRED):
                if len(usual) > 1:
                    recordings = ", ".join(g.recording.relative_to(path).as_posix() for g in usual)
                    raise CaptureError(
                        f"{path}: several folders have {kind} of the cameras in {origin.name}: {recordings}. Give the one to read, "
                        f"such as {quoted([usual[0].recording])}."
                    )
                found = [fit for fit in found if fit[0] is usual[0]]
            if found:
                group, pairs = found[0]
                return {name: group.files[own] for name, own in pairs.items()}  # type: ignore[return-value]
    raise _unpaired(path, names, origin, groups)


def has_media(path: Path, names: list[str]) -> bool:
    """Return True if a folder has videos or images of at least two cameras, by their names."""
    return any(len(_near(names, group)) > 1 for group in _groups(path))


def _pairs(
    names: list[str], group: _Group, simplify: Callable[[list[str]], list[Any]], partial: bool
) -> dict[str, str]:
    """Return the name of each camera's media, or nothing if they do not fit the cameras one to one."""
    own = list(group.files)
    wanted, offered = simplify(names), simplify(own)
    if len(set(wanted)) < len(names) or len(set(offered)) < len(own):
        return {}
    places = dict(zip(offered, own, strict=True))
    found = {name: places[key] for name, key in zip(names, wanted, strict=True) if key in places}
    return found if partial or len(found) == len(names) else {}


def _plain(names: list[str]) -> list[str]:
    """Return names in lower case, without the extension of a video or image."""
    return [_stem(name).lower() for name in names]


def _stem(name: str) -> str:
    stem, extension = os.path.splitext(name)
    return stem if extension.lower() in (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES) else name


def _distinct(names: list[str]) -> list[tuple[str | int, ...]]:
    """Return the words and numbers of each name without those at the start and end that all names have in common."""
    words = [[int(w) if w.isdigit() else w.lower() for w in WORD.findall(_stem(name))] for name in names]
    if len(words) < 2:
        return [tuple(w) for w in words]
    start = _common(words)
    end = _common([w[start:][::-1] for w in words])
    return [tuple(w[start : len(w) - end]) for w in words]


def _common(words: list[list[str | int]]) -> int:
    columns = takewhile(lambda column: len(set(column)) == 1, zip(*words, strict=False))
    return len(list(columns))


def _serials(names: list[str]) -> list[str]:
    """Return the serial number at the end of each name, otherwise the whole name."""
    found = [SERIAL.search(_stem(name)) for name in names]
    return [name if serial is None else serial[0] for name, serial in zip(names, found, strict=True)]


SIMPLER: tuple[Callable[[list[str]], list[Any]], ...] = (list, _plain, _distinct, _serials)
"""Functions that make names comparable, the strictest first."""


def _groups(path: Path) -> Iterator[_Group]:
    for folder in [*_folders(path, DEPTH), *(path / name for name in SHARED if (path / name).is_dir())]:
        entries = list_folder(folder)
        below = [entry for entry in entries if entry.is_dir()]
        found: tuple[Media, ...] = (
            _by_stem([file for file in entries if file.suffix.lower() in VIDEO_SUFFIXES and file.is_file()]),
            {entry.name: entry for entry in below if segment_files(entry)},
            {entry.name: files for entry in below if (files := image_files(entry))},
            {name: [file] for name, file in _by_stem(image_files(folder)).items()},
        )
        for kind, files in zip(KINDS, found, strict=True):
            if files:
                yield _Group(folder, kind, files)


def _by_stem(files: list[Path]) -> dict[str, Path]:
    stems = Counter(file.stem for file in files)
    return {file.stem if stems[file.stem] == 1 else file.name: file for file in files}


def _folders(path: Path, depth: int) -> Iterator[Path]:
    yield path
    for entry in list_folder(path) if depth else []:
        if entry.is_dir() and not SKIPPED.fullmatch(entry.name):
            yield from _folders(entry, depth - 1)


def _unpaired(path: Path, names: list[str], origin: Path, groups: list[_Group]) -> CaptureError:
    if not groups:
        return CaptureError(
            f"{path}: holds no videos or images of the cameras {listed(names)} in {origin.name}. Copy a video of each, named as its "
            f"camera, beside {origin.name} or into videos/, or its images into images/CAMERA/."
        )
    best = max(groups, key=lambda group: (len(_near(names, group)), -group.rank(path), len(group.files)))
    absent = [name for name in names if name not in _near(names, best)] or names
    place = best.folder.relative_to(path).as_posix()
    alike = get_close_matches(absent[0], list(best.files), 1)
    hint = f" Is it {alike[0]!r}?" if alike else ""
    if flat := flat_images(best.folder):
        hint = f" {flat}"
    return CaptureError(
        f"{path}: no {best.kind} in {place} belong to {len(absent)} of the {len(names)} cameras in {origin.name}, the first is "
        f"{absent[0]!r}; there are {listed(list(best.files))}.{hint} Name each as its camera, or remove cameras without any from "
        f"{origin.name}."
    )


def _near(names: list[str], group: _Group) -> dict[str, str]:
    """Return the cameras that have media in a group, with their own names."""
    return max((_pairs(names, group, simplify, True) for simplify in SIMPLER), key=len)
