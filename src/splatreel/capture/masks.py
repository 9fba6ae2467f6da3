"""Masks of a capture: their files, and the capture of a subject, whose surroundings a color replaces."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import cycle, product
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from splatreel.base.command_line import option, quoted
from splatreel.base.errors import CaptureError
from splatreel.base.progress import listed
from splatreel.base.untrusted import read_json
from splatreel.capture.base import Capture, Color, read_cameras
from splatreel.capture.capture_sound import Track
from splatreel.capture.color import over_color
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.files import list_folder, locate_files
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.image_sequences import IMAGE_SUFFIXES, image_files
from splatreel.capture.images import MOST_COLOR, image_size, read_image, same_shape
from splatreel.capture.time_steps import CountedSource, OwnFrames
from splatreel.capture.video import VideoFile
from splatreel.scene.reel_source import ReelSource

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi")
DARKEST_WHITE = 128
"""Gray level that the brightest pixel of a mask must have, unless the mask is black. Masks with the labels 0 and 1 have less."""
MADE_MASKS = "masks"
"""Folder in the output folder of a run for the masks that `--masks auto` makes."""
LIKELY_GRAY, UNLIKELY_GRAY = 160, 96
"""Gray levels of pixels in masks of `capture masks` that may or may not show the subject: more likely, and less likely."""
DOUBT = 64, 192
"""Gray levels between which a pixel of these masks is in doubt. An image editor may have smoothed them. The other levels tell the
opacity (`level_of_opacity`)."""
RECORD = "splatreel-masks.json"
"""File in a folder of masks that `capture masks` made. Its masks belong to undistorted images. Masks of a video are named by the
numbers of its frames, six digits from 000000 on."""
RECORD_BYTES = 1 << 20


def read_mask_record(folder: Path) -> dict[str, Any] | None:
    """Return the record of a folder of masks that `capture masks` made, or None.

    Raises:
        CaptureError: The record is damaged.
    """
    file = folder / RECORD
    if not os.path.lexists(file):
        return None

    def damaged(problem: str) -> CaptureError:
        return CaptureError(f"{problem.rstrip('.')}. Delete the folder, and make the masks again.")

    record = read_json(file, damaged, RECORD_BYTES)
    if not isinstance(record, dict):
        raise damaged(f"{file}: is not a record of masks")
    return record


@dataclass(frozen=True)
class _CameraMasks:
    """Masks of a camera: a video, or an image for each number of its frames. numbers: [T] number for each time step."""

    numbers: np.ndarray
    images: Sequence[Path]
    video: VideoFile | None


class MaskFiles:
    """Masks of a capture in a folder. Names are those of the cameras, images are named or numbered as the camera's frames.

    Args:
        folder: Folder of the masks, or its address.
        capture: Capture that they belong to.
        names: Names of the cameras whose masks are read; None means all.

    Attributes:
        absent: Names of cameras without masks: held-out ones, or those of `names`. Their masks are read as black.

    Raises:
        CaptureError: The masks of a camera that is trained on are missing, or masks do not fit their camera's frames or their size.
    """

    def __init__(self, folder: str | Path, capture: FileCapture, names: Sequence[str] | None = None) -> None:
        self._files, self.folder = locate_files(folder)
        self._capture = capture
        source = capture.source
        if capture.growing or not isinstance(source, CountedSource):
            raise CaptureError(
                f"{capture.path}: is still being written. Masks need a finished capture: leave out --masks or --follow."
            )
        if not self.folder.is_dir():
            raise CaptureError(f"{folder}: is not a folder of masks. Give the folder that holds masks for each camera.")
        self._record = read_mask_record(self.folder)
        self._pairings: dict[str, list[str]] = {}
        wanted = [camera.name for camera in capture.cameras if names is None or camera.name in names]
        spare = capture.held_out if names is None else names
        self.absent = [name for name in wanted if name in spare and not self._has(name)]
        self._masks = {
            name: self._of_camera(name, source.own_frames(name)) for name in wanted if name not in self.absent
        }
        self.notes = [f"masks of {', '.join(names)} {pairing}" for pairing, names in self._pairings.items()]
        if self.absent:
            self.notes.append(
                f"{folder}: there are no masks of {listed(self.absent)}, which training does not need. `evaluate` compares with "
                f"cameras that have masks"
            )

    def read(self, first: int, count: int, name: str) -> np.ndarray:
        """Return the masks of a camera as the images are read, [count, H, W] uint8.

        Args:
            first: First time step, counted from the first one of the files.
            count: Number of time steps.
            name: Name of the camera.

        Raises:
            CaptureError: A mask cannot be read, or is none.
        """
        capture = self._capture
        if name in self.absent:
            return np.zeros((count, capture.height, capture.width), np.uint8)
        out = np.empty((count, capture.height, capture.width, 3), np.uint8)
        if self._is_undistorted:
            self._read_camera(out, first, name)
        else:
            capture.read_undistorted(self._read_camera, out, first, name)
        return out[..., 1].copy()

    def sources(self, first: int, count: int) -> list[Path]:
        """Return the files that hold the masks of `count` time steps from `first` on."""
        found: list[Path] = []
        for masks in self._masks.values():
            used = masks.numbers[first : first + count]
            found += [masks.video.path] if masks.video else [masks.images[number] for number in used]
        return list(dict.fromkeys(found))

    def digest(self, first: int, count: int) -> str:
        """Return a short string that changes with the content of the masks of `count` time steps from `first` on."""
        digest = hashlib.sha256()
        for file in self.sources(first, count):
            digest.update(file.relative_to(self.folder).as_posix().encode())
            with self._files.raw(file) as data:
                digest.update(hashlib.file_digest(cast(Any, data), "sha256").digest())
        return digest.hexdigest()[:16]

    def close(self) -> None:
        """Close open files."""
        for masks in self._masks.values():
            if masks.video is not None:
                masks.video.close()

    @property
    def have_doubts(self) -> bool:
        """True for masks of `capture masks`: middle gray levels are doubt (`DOUBT`), and the images are mixed along borders."""
        return self._record is not None and self._record.get("doubts") is True

    @property
    def _is_undistorted(self) -> bool:
        return self._record is not None and self._record.get("undistorted") is True

    def _of_camera(self, name: str, own: OwnFrames) -> _CameraMasks:
        if self._record is not None and own.stems is None:
            own = replace(own, stems=[f"{number:06d}" for number in range(own.count)])
        place = self._place(name)
        if place.suffix.lower() in VIDEO_SUFFIXES and place.is_file():
            video = VideoFile(place, self._files)
            self._check_size(place, name, (video.width, video.height))
            self._check_count(place, name, video.frames, own)
            return _CameraMasks(own.numbers, (), video)
        images = [place] if place.is_file() else image_files(place)
        if not images:
            raise CaptureError(f"{place}: holds no images. Copy the masks of camera {name} there.")
        self._check_size(images[0], name, image_size(images[0], self._files))
        if own.stems is not None:
            images = self._paired(place, name, images, own, own.stems)
        else:
            self._check_count(place, name, len(images), own)
        return _CameraMasks(own.numbers, images, None)

    def _has(self, name: str) -> bool:
        """Return True if there is a file with masks of a camera, or a folder that is not empty."""
        return any(bool(image_files(place)) if place.is_dir() else True for place in self._places(name))

    def _places(self, name: str) -> list[Path]:
        """Return the folder of a camera's masks, or files of its name."""
        folder = self.folder / name
        if folder.is_dir():
            return [folder / "images" if not image_files(folder) and (folder / "images").is_dir() else folder]
        names = {folder.name, folder.stem if folder.suffix.lower() in IMAGE_SUFFIXES else folder.name}
        kinds = (*VIDEO_SUFFIXES, *IMAGE_SUFFIXES)
        return [file for file in list_folder(folder.parent) if file.stem in names and file.suffix.lower() in kinds]

    def _place(self, name: str) -> Path:
        """Return the folder or file of a camera's masks."""
        found = self._places(name)
        if len(found) > 1:
            raise CaptureError(
                f"{self.folder}: both {found[0].name} and {found[1].name} are masks of camera {name}. Remove one."
            )
        if not found:
            raise CaptureError(
                f"{self.folder}: there are no masks of camera {name}. Add a folder {name} with an image for each frame, or a video "
                f"{name}.mp4, or leave the camera out with {quoted(option('--leave-out', name))}."
            )
        return found[0]

    def _paired(self, place: Path, name: str, images: list[Path], own: OwnFrames, stems: Sequence[str]) -> list[Path]:
        """Return the mask of each image of a camera: the file of the same name, or of the same place in equal numbers of files."""
        by_stem = {file.stem: file for file in images}
        without, unused = [stem for stem in stems if stem not in by_stem], sorted(set(by_stem) - set(stems))
        if without and len(images) == own.count and self._record is None:
            offset = _offset(stems, [file.stem for file in images])
            if offset:
                self._note(
                    name, f"begin at {images[0].stem} where its images begin at {stems[0]}: they are paired in order"
                )
            elif offset is None and len(without) == len(stems) > 1:
                self._note(name, "have other names than its images and are paired with them in order")
            if offset is not None or len(without) == len(stems):
                return images
        if len(without) == len(stems):
            self._check_count(place, name, len(images), own)
        if without and unused:
            raise CaptureError(
                f"{place}: the {len(images)} masks and the {own.count} images of camera {name} have different names: there is no mask "
                f"{without[0]}, and no image {unused[0]}. If masks and images count from different numbers, "
                f"rename the masks as the images; else add the masks that are missing."
            )
        capture = self._capture
        used = own.numbers[capture.first_frame : capture.first_frame + capture.frames]
        for number in used:
            if stems[number] in without:
                raise CaptureError(
                    f"{place}: there is no mask {stems[number]} for the image of this name of camera {name}. Its masks are "
                    f"{images[0].stem} to {images[-1].stem}, its images {stems[0]} to {stems[-1]}. Add the mask; or, if masks and "
                    f"images count from different numbers, rename the masks as the images."
                )
        if len(images) != own.count and self._record is None:
            self._note(name, f"are {len(images)} for {own.count} images and are paired with those of the same names")
        return [by_stem.get(stem, images[0]) for stem in stems]

    def _note(self, name: str, pairing: str) -> None:
        self._pairings.setdefault(pairing, []).append(name)

    def _check_count(self, place: Path, name: str, found: int, own: OwnFrames) -> None:
        if found != own.count:
            raise CaptureError(
                f"{place}: holds {found} masks, but camera {name} has {own.count} frames. Give a mask for each frame"
                + (", or name the masks as the images." if own.stems is not None else ".")
            )

    def _check_size(self, file: Path, name: str, found: tuple[int, int]) -> None:
        capture = self._capture
        expected = (capture.width, capture.height) if self._is_undistorted else capture.source.size(name)
        if not same_shape(found, expected):
            raise CaptureError(
                f"{file}: is {found[0]}x{found[1]}, but the images of camera {name} are {expected[0]}x{expected[1]}. Make the mask at "
                f"the size of the images."
            )

    def _read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Read masks into out [count, H, W, 3], gray."""
        masks = self._masks[name]
        numbers = masks.numbers[first : first + len(out)]
        if masks.video is not None:
            masks.video.read_into(out, numbers)
        size = None
        for place, number in enumerate(numbers):
            file = masks.video.path if masks.video else masks.images[number]
            if masks.video is None:
                size = size or image_size(masks.images[0], self._files)
                out[place] = read_image(file, out.shape[2], out.shape[1], size=size, mask=True, files=self._files)
            _check_levels(file, int(number), out[place])


def _check_levels(file: Path, number: int, mask: np.ndarray) -> None:
    if int((mask.max(2) - mask.min(2)).max()) > MOST_COLOR:
        raise CaptureError(
            f"{file}: frame {number} is colored. Masks are gray: white is the subject, black is not. A cut-out "
            f"is transparent around the subject."
        )
    brightest = int(mask.max())
    if 0 < brightest < DARKEST_WHITE:
        raise CaptureError(
            f"{file}: the brightest pixel of frame {number} is {brightest} of 255. Write the subject as white, 255."
        )


def _offset(stems: Sequence[str], others: Sequence[str]) -> int | None:
    """Return by how much the numbers in names of other files are larger; None without one difference common to all."""
    numbers, other_numbers = _numbers(stems), _numbers(others)
    if numbers is None or other_numbers is None:
        return None
    differences = {other - own for own, other in zip(numbers, other_numbers, strict=True)}
    return differences.pop() if len(differences) == 1 else None


def _numbers(stems: Sequence[str]) -> list[int] | None:
    """Return the last number in each name that is not the same in all names, or None."""
    found = [[int(number) for number in re.findall(r"\d+", stem)] for stem in stems]
    columns = list(zip(*found, strict=True)) if len({len(numbers) for numbers in found}) == 1 else []
    return next((list(column) for column in reversed(columns) if len(set(column)) > 1), None)


PALETTE: tuple[Color, ...] = ((0, 0, 0), (1, 1, 1), (1, 0, 0), (0, 1, 1), (0, 1, 0), (1, 0, 1), (0, 0, 1), (1, 1, 0))
"""Backgrounds of the cameras, in turn. No Gaussian outside of the masks has the right color for several cameras. Levels of 0 and
255 carry no exposure, so that `motion.exposure` ignores them."""


UNLIKELY, LIKELY = 127, 128
"""Opacities of pixels that may or may not show the subject: less likely, and more likely. In masks without doubts, opacities of 127 and
128 become 126 and 129."""


class Masks(Protocol):
    """Masks of all cameras.

    Attributes:
        notes: Sentences about masks that are paired with images of other names.
    """

    notes: list[str]

    @property
    def have_doubts(self) -> bool:
        """True for masks of `capture masks`: middle gray levels are doubt (`DOUBT`), and the images are mixed along borders."""
        ...

    def read(self, first: int, count: int, name: str) -> np.ndarray:
        """Return the masks of a camera as the images are read, [count, H, W] uint8. `first` counts from the files' first step."""
        ...

    def sources(self, first: int, count: int) -> list[Path]:
        """Return the files that are read."""
        ...

    def digest(self, first: int, count: int) -> str:
        """Return a short string that changes with the content of the masks."""
        ...

    def close(self) -> None:
        """Close open files."""
        ...


class MaskedCapture(Capture):
    """Capture of a subject.

    Args:
        capture: Capture of the whole scene.
        masks: Masks of its images.
        background: Color outside of the masks, 0..1; None gives each camera its color of the `PALETTE`, for training.
        unmasked: Names of cameras without masks.
    """

    def __init__(
        self, capture: Capture, masks: Masks, background: Color | None = None, unmasked: Sequence[str] = ()
    ) -> None:
        self.unmasked = list(unmasked)
        self._capture = capture
        self._masks = masks
        colors = cycle(PALETTE if background is None else (background,))
        self._backgrounds = {camera.name: color for camera, color in zip(capture.cameras, colors, strict=False)}
        super().__init__(
            capture.path,
            capture.cameras,
            held_out=capture.held_out,
            frame_range=(capture.first_frame, capture.first_frame + capture.frames),
            fps=capture.fps,
            points=capture.points,
            point_colors=capture.point_colors,
            near=capture.near,
            origin=capture.origin,
            notes=[*capture.notes, *masks.notes],
        )
        # Images with an opacity are composed over black when they are read. If that opacity is the mask, it counts once.
        read = set(masks.sources(self.first_frame, self.frames))
        self._is_composed = bool(read) and read <= set(capture.sources())

    @property
    def layout(self) -> str:
        """Name of the layout of files."""
        return self._capture.layout

    @property
    def scene(self) -> Capture:
        """Capture of the whole scene."""
        return self._capture

    @property
    def backgrounds(self) -> dict[str, Color]:
        """Color behind the subject by camera, 0..1."""
        return self._backgrounds

    def alpha(self, first: int, count: int, cameras: list[str]) -> np.ndarray:
        """Return the opacity of the subject, [count, len(cameras), H, W] uint8, `UNLIKELY` or `LIKELY` where masks do not tell."""
        levels = np.stack([self._masks.read(self.first_frame + first, count, name) for name in cameras], 1)
        if self._masks.have_doubts:
            likely = np.where(levels < LIKELY, np.uint8(UNLIKELY), np.uint8(LIKELY))
            return np.where(_in_doubt(levels), likely, opacity_of_level(levels))
        return np.where(
            levels == UNLIKELY, np.uint8(UNLIKELY - 1), np.where(levels == LIKELY, np.uint8(LIKELY + 1), levels)
        )

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        self._capture.read_into(out, first - self._capture.first_frame, cameras)
        read_cameras(self._compose, out, first, cameras)

    def _compose(self, out: np.ndarray, first: int, name: str) -> None:
        color = np.rint(255 * np.array(self._backgrounds[name])).astype(np.uint8)
        levels = self._masks.read(first, len(out), name)
        if self._masks.have_doubts:
            levels = np.where(_in_doubt(levels), np.where(levels < LIKELY, np.uint8(0), np.uint8(255)), levels)
            levels = opacity_of_level(levels)
        for image, alpha in zip(out, levels, strict=True):
            if self._is_composed:
                image += over_color(np.zeros_like(image), alpha, color)
            else:
                seen = without_mixing(image, alpha) if self._masks.have_doubts else image
                image[:] = over_color(seen, alpha, color)

    def _missing(self, first: int, count: int, name: str) -> np.ndarray:
        return self._capture.missing(first - self._capture.first_frame, count, [name])[:, 0]

    def tracks(self) -> dict[str, Track]:
        """Return the sound by camera."""
        return self._capture.tracks()

    def frame_tables(self) -> dict[str, FrameTable]:
        """Return the frame tables of the videos."""
        return self._capture.frame_tables()

    def sources(self) -> list[Path]:
        """Return the files of the capture. `describe` has the content of the masks."""
        return self._capture.sources()

    def reel_source(self) -> ReelSource | None:
        """Return what a reel of this capture says about its frames and cameras."""
        source = self._capture.reel_source()
        return source and replace(source, part="masks")

    def describe(self) -> dict[str, Any]:
        """Return the readable differences between captures, with a string for the content of the masks."""
        return super().describe() | {"masks": self._digest}

    @cached_property
    def _digest(self) -> str:
        return self._masks.digest(self.first_frame, self.frames)

    def close(self) -> None:
        """Close open files."""
        self._masks.close()
        self._capture.close()


def is_doubtful(alpha: np.ndarray) -> np.ndarray:
    """Return which opacities [...] uint8 are in doubt, [...] bool."""
    return (alpha == UNLIKELY) | (alpha == LIKELY)


def level_of_opacity(opacity: np.ndarray) -> np.ndarray:
    """Return the gray levels [...] uint8, none in `DOUBT`, by which masks of `capture masks` tell opacities [...] uint8."""
    return np.where(opacity < LIKELY, opacity // 2, 128 + opacity // 2).astype(np.uint8)


def opacity_of_level(levels: np.ndarray) -> np.ndarray:
    """Return the opacities [...] uint8 that gray levels [...] uint8 out of doubt tell, never `UNLIKELY` or `LIKELY`."""
    return np.where(levels < LIKELY, 2 * levels, 2 * levels - 255).astype(np.uint8)


BORDER_REACH = 2
"""Distance, pixels, within which the subject's color at a border pixel is looked for."""


def inner_colors(image: np.ndarray, inside: np.ndarray, border: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the color of the subject at its border pixels, by the nearest pixels inside.

    Args:
        image: [H, W, 3] uint8.
        inside: [H, W] bool, pixels that show nothing but the subject.
        border: [H, W] bool, N pixels that may also show what is behind it.

    Returns:
        Colors [N, 3] float32, 0..255, in the order of `np.nonzero(border)`, and whether there are pixels inside nearby, [N] bool.
    """
    rows, columns = np.nonzero(border)
    total, weights = np.zeros((len(rows), 3), np.float32), np.zeros((len(rows), 1), np.float32)
    reach = range(-BORDER_REACH, BORDER_REACH + 1)
    for down, right in product(reach, reach):
        row, column = (rows + down).clip(0, inside.shape[0] - 1), (columns + right).clip(0, inside.shape[1] - 1)
        weight = inside[row, column, None] * np.float32(np.exp(-(down**2 + right**2) / 2))
        total += weight * image[row, column]
        weights += weight
    return total / np.maximum(weights, 1e-6), weights[:, 0] > 0


def without_mixing(image: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    """Return an image [H, W, 3] uint8 whose partly transparent pixels show the subject alone. `opacity` is [H, W] uint8."""
    border = (opacity > 0) & (opacity < 255)
    colors, known = inner_colors(image, opacity == 255, border)
    found = image.copy()
    found[border] = np.where(known[:, None], colors.round(), image[border])
    return found


def _in_doubt(levels: np.ndarray) -> np.ndarray:
    return (levels >= DOUBT[0]) & (levels < DOUBT[1])
