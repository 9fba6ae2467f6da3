"""Image files: reading, writing, and the images of several cameras."""

from __future__ import annotations

import struct
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import av
import numpy as np
from av.video.reformatter import Interpolation
from PIL import Image, ImageCms, UnidentifiedImageError

from splatreel.base import threads
from splatreel.base.errors import CaptureError
from splatreel.capture.color import over_black, sentences
from splatreel.capture.files import LOCAL, Files, open_media
from splatreel.capture.orientation import EXIF, STORED, Orientation

ORIENTATION = 0x112
"""Number of the orientation in EXIF."""
TAIL = 1 << 16
"""Bytes at the end of a PNG file that are searched for EXIF."""
DEEP = ("I;16", "I;16B", "I;16L", "I;16N")
"""Pillow's modes with 16 bits per pixel."""
READ = ("1", "L", "LA", "La", "P", "PA", "RGB", "RGBA", "RGBa", "RGBX", "CMYK", "YCbCr", *DEEP)
"""Pillow's modes that are converted. Integers of 32 bits and floats have no known white."""
ALPHA = ("LA", "La", "PA", "RGBA", "RGBa")
"""Pillow's modes with an opacity."""
SPACES = {"RGB": "RGB", "GRAY": "L", "CMYK": "CMYK"}
"""Pillow's modes by the color space of an ICC profile."""
UNNOTICED = 2
"""Maximum difference, in levels of 255, of a profile that counts as sRGB."""
SATURATED = 0.5
"""Smallest share of the pixels above 0 that have the level 255, in a mask of 16 bits that holds levels of 8 bits."""
OPAQUE, CLEAR = 250, 5
"""Opacity above which and below which a mask's opacity is that of an opaque or a transparent image."""
MOST_COLOR = 48
"""Maximum difference between the channels of a mask. Compression changes gray by less."""
BILEVEL, FEWEST = 0.98, 0.005
"""Smallest share of the visible pixels that are black or white, and of those of either kind, where gray levels are the mask."""
FAILURES = (OSError, UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError)
"""Errors of Pillow for damaged files."""


@dataclass(frozen=True)
class ImageHeader:
    """Properties of an image file that are known without decoding it."""

    size: tuple[int, int]
    orientation: Orientation
    conversions: list[str]

    def shown_size(self, upright: bool) -> tuple[int, int]:
        """Return width and height of the image, upright or as stored."""
        return self.orientation.size(*self.size) if upright else self.size


def read_header(path: Path, files: Files = LOCAL) -> ImageHeader:
    """Return the properties of an image file without decoding it."""
    try:
        with Image.open(files.source(path)) as image:
            return ImageHeader(image.size, _orientation(image), _conversions(image))
    except FAILURES as error:
        raise _unreadable(path, error) from error


def image_size(path: Path, files: Files = LOCAL, *, upright: bool = True) -> tuple[int, int]:
    """Return width and height of an image file without decoding it. `upright` obeys EXIF."""
    return read_header(path, files).shown_size(upright)


def read_image(
    path: Path,
    width: int,
    height: int,
    files: Files = LOCAL,
    *,
    upright: bool = True,
    size: tuple[int, int] | None = None,
    mask: bool = False,
) -> np.ndarray:
    """Return an image resized by area to width x height, uint8 [height, width, 3] sRGB.

    Args:
        path: Image file.
        width: Output width in pixels.
        height: Output height in pixels.
        files: Access to the file.
        upright: True obeys EXIF, False returns the image as it is stored.
        size: Required width and height of the file's image, or None.
        mask: True reads a mask: the opacity of an image that has one, the gray level of another. Opacity that is the same everywhere
            says nothing, so that the gray level counts.

    Raises:
        CaptureError: The file cannot be read, has another size, or is a mask without white.
    """
    pixels, orientation = _decoded(path, files, upright, mask)
    found = orientation.size(pixels.shape[1], pixels.shape[0])
    if size is not None and found != size:
        raise CaptureError(
            f"{path}: is {found[0]}x{found[1]}, the first image of its camera is {size[0]}x{size[1]}. Bring all images of a camera "
            f"to one size."
        )
    width, height = orientation.size(width, height)
    if pixels.shape[:2] != (height, width):
        frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")  # resample as videos are
        pixels = frame.reformat(width, height, "rgb24", interpolation=Interpolation.AREA).to_ndarray()
    return orientation.apply(pixels)


def read_whole_image(path: Path, files: Files = LOCAL) -> np.ndarray:
    """Return an upright image at its own size, uint8 [H, W, 3] sRGB."""
    pixels, orientation = _decoded(path, files, True, False)
    return orientation.apply(pixels)


def _decoded(path: Path, files: Files, upright: bool, mask: bool) -> tuple[np.ndarray, Orientation]:
    """Return an image as it is stored, [H, W, 3] uint8 sRGB, and its orientation."""
    try:
        with Image.open(files.source(path)) as image:
            orientation = _orientation(image) if upright else STORED
            is_reduced = image.mode not in DEEP and any(";16" in str(tile) for tile in image.tile)
            image.load()
            if image.mode not in READ and not (image.mode == "I" and image.format == "PNG"):
                raise ValueError(
                    f"its pixels are of kind {image.mode}, whose white is unknown; convert it to 8 or 16 bits"
                )
            if not mask:
                return _rgb(image), orientation
            levels = _mask_levels(path, image)
    except FAILURES as error:
        raise _unreadable(path, error) from error
    if is_reduced and not levels.any() and (brightest := _brightest_of_16_bits(path, files)):
        raise _too_dark(path, brightest)
    return levels, orientation


def _conversions(image: Image.Image) -> list[str]:
    found = ["16 bits are reduced to 8"] if image.mode in DEEP else []
    profile = image.info.get("icc_profile")
    if profile and _to_srgb(profile)[1] is not None:
        found.append("colors are converted from the ICC profile to sRGB")
    elif image.mode == "CMYK":
        found.append("CMYK without a usable ICC profile is converted by its inverse")
    if image.format != "MPO" and getattr(image, "n_frames", 1) > 1:  # an MPO is a JPEG whose other images are previews
        found.append("only the first image of a file with several is read")
    return [*found, "transparent pixels are composed over black"] if _has_alpha(image) else found


def _rgb(image: Image.Image) -> np.ndarray:
    profile = image.info.get("icc_profile")
    if image.mode in DEEP or image.mode == "I":
        values = np.asarray(image)
        levels = (values >> 8).astype(np.uint8)  # as OpenCV, and as Pillow does for colors
        clear = image.info.get("transparency")
        levels[values == clear if isinstance(clear, int) else np.zeros(values.shape, bool)] = 0
        image = Image.fromarray(levels)
    elif _has_alpha(image):
        pixels = np.asarray(image.convert("RGBA"))
        opaque = Image.fromarray(np.ascontiguousarray(pixels[..., :3])).convert("L" if image.mode == "LA" else "RGB")
        return over_black(np.concatenate([_converted(opaque, profile), pixels[..., 3:]], 2))
    return _converted(image, profile)


def _mask_levels(path: Path, image: Image.Image) -> np.ndarray:
    if image.mode in DEEP or image.mode == "I":
        values = np.asarray(image)
        brightest = int(values.max())
        if 0 < brightest <= 255 and (values == 255).sum() >= SATURATED * (values > 0).sum():
            return np.repeat(values.astype(np.uint8)[..., None], 3, 2)
        if 0 < brightest < 1 << 15:
            raise _too_dark(path, brightest)
    if not _has_alpha(image):
        return _rgb(image)
    pixels = np.asarray(image.convert("RGBA"))
    colors, opacity = pixels[..., :3], pixels[..., 3]
    is_gray = int((colors.max(2) - colors.min(2)).max()) <= MOST_COLOR
    if int(opacity.max()) < CLEAR and is_gray and colors.max() >= 128:
        raise CaptureError(
            f"{path}: is transparent everywhere, but its gray levels look like a mask. Save it without an opacity."
        )
    is_even = int(opacity.max()) - int(opacity.min()) <= 255 - OPAQUE and opacity.max() >= CLEAR
    if is_even and (is_gray or opacity.min() >= OPAQUE):
        return colors
    shown = colors[opacity >= 128].mean(1)
    black, white = shown <= 16, shown >= 239
    if is_gray and (black | white).mean() >= BILEVEL and min(black.mean(), white.mean()) >= FEWEST:
        return over_black(pixels)  # the opacity only marks the area that the image fills
    return np.repeat(opacity[..., None], 3, 2)


def _brightest_of_16_bits(path: Path, files: Files) -> int:
    """Return the largest level of an image of 16 bits, of which Pillow reads the upper 8."""
    with open_media(files, path) as opened:
        frame = next(opened.decode(video=0))
    return int(frame.reformat(format="rgb48le").to_ndarray().max())


def _too_dark(path: Path, brightest: int) -> CaptureError:
    return CaptureError(
        f"{path}: the brightest pixel of this mask is {brightest} of 65535. Write the subject as white, or save the mask with 8 bits."
    )


def _converted(image: Image.Image, profile: bytes | None) -> np.ndarray:
    mode, transform = _to_srgb(profile) if profile else ("", None)
    fits = mode == image.mode if {mode, image.mode} & {"CMYK"} or mode == "L" else True
    if transform is not None and fits:
        image = cast(Image.Image, ImageCms.applyTransform(image.convert(mode), transform))
    return np.asarray(image.convert("RGB"))


@lru_cache(maxsize=8)
def _to_srgb(profile: bytes) -> tuple[str, Any]:
    """Return Pillow's mode for an ICC profile, and its transform to sRGB; None if it is sRGB, damaged or of another kind."""
    try:
        source = ImageCms.ImageCmsProfile(BytesIO(profile))
        mode = SPACES[cast(Any, source.profile).xcolor_space.strip()]
        target, intent = ImageCms.createProfile("sRGB"), ImageCms.Intent.RELATIVE_COLORIMETRIC
        flags = ImageCms.Flags.BLACKPOINTCOMPENSATION
        transform = ImageCms.buildTransform(source, target, mode, "RGB", intent, flags)
        if mode == "CMYK":
            return mode, transform
        steps = np.rint(np.linspace(0, 255, 9)).astype(np.uint8)
        colors = np.stack(np.meshgrid(steps, steps, steps), -1).reshape(9, 81, 3)
        sample = Image.fromarray(colors if mode == "RGB" else colors[..., 0].copy())
        applied = ImageCms.applyTransform(sample, transform)
        same = np.abs(np.asarray(applied).astype(int) - np.asarray(sample.convert("RGB"))).max() <= UNNOTICED
    except (ImageCms.PyCMSError, OSError, KeyError, ValueError, TypeError):
        return "", None
    return mode, None if same else transform


def _has_alpha(image: Image.Image) -> bool:
    palette = image.palette.mode if image.mode == "P" and image.palette else ""
    return image.mode in ALPHA or palette.endswith("A") or ("transparency" in image.info and image.mode not in DEEP)


def _orientation(image: Image.Image) -> Orientation:
    """Return the orientation in a file's EXIF. Pillow applies that of TIFF files itself."""
    data = image.info.get("exif")
    if data is None and image.format == "PNG" and b"eXIf" in _tail(image):
        image.load()
        data = image.info.get("exif")
    if not data or image.format == "TIFF":
        return STORED
    exif = Image.Exif()
    try:
        exif.load(data)
        return EXIF.get(exif.get(ORIENTATION, 1), STORED)
    except (OSError, SyntaxError, ValueError, TypeError, struct.error):  # OpenCV ignores damaged EXIF, too
        return STORED


def _tail(image: Any) -> bytes:
    at = image.fp.tell()
    size = image.fp.seek(0, 2)
    image.fp.seek(max(size - TAIL, 0))
    data = image.fp.read(TAIL)
    image.fp.seek(at)
    return data


def _unreadable(path: Path, error: Exception) -> CaptureError:
    if not path.exists():
        return CaptureError(f"{path}: is missing, though the capture's description names it. Copy it there.")
    return CaptureError(f"{path}: cannot be read as an image ({error}). Replace the file or leave it out.")


def encode_image(image: np.ndarray | Image.Image, suffix: str, **options: Any) -> bytes:
    """Return the content of an image file.

    Pillow writes to a file without a look at how much of it the disk took, so that a full disk cuts images silently.

    Args:
        image: Pixels [H, W] or [H, W, 3] uint8, or an image of Pillow.
        suffix: Suffix of the file, which names the format.
        **options: Options of Pillow for the format.
    """
    made = BytesIO()
    opened = image if isinstance(image, Image.Image) else Image.fromarray(image)
    opened.save(made, Image.registered_extensions()[suffix], **options)
    return made.getvalue()


class CameraImages:
    """Images of several cameras. All images of a camera have one size.

    Args:
        first: First image of each camera.
        files: Access to the files.
        upright: True obeys EXIF as OpenCV does, False ignores it as COLMAP does.
    """

    def __init__(self, first: dict[str, Path], files: Files, upright: bool) -> None:
        self._first = first
        self._files = files
        self._upright = dict.fromkeys(first, upright)

    @cached_property
    def _headers(self) -> dict[str, ImageHeader]:
        with ThreadPoolExecutor(threads.count()) as pool:
            found = pool.map(lambda file: read_header(file, self._files), self._first.values())
            return dict(zip(self._first, found, strict=True))

    def size(self, name: str, calibrated: tuple[int, int] | None = None) -> tuple[int, int]:
        """Return width and height of a camera's images.

        Args:
            name: Name of the camera.
            calibrated: Width and height of its calibration. They decide whether EXIF is obeyed, if only one way fits.
        """
        header, upright = self._headers[name], self._upright[name]
        if calibrated is not None and not same_shape(header.shown_size(upright), calibrated):
            self._upright[name] = upright != same_shape(header.shown_size(not upright), calibrated)
        return header.shown_size(self._upright[name])

    def read(self, out: np.ndarray, name: str, file: Path) -> None:
        """Read an image of a camera into out [H, W, 3] uint8 sRGB, resized by area.

        Raises:
            CaptureError: The image cannot be read, or has another size than the camera's first one.
        """
        upright, size = self._upright[name], self.size(name)
        out[:] = read_image(file, out.shape[1], out.shape[0], self._files, upright=upright, size=size)

    def conversions(self) -> list[str]:
        """Return sentences about conversions of the images that users should know of."""
        phrases = {}
        for name, header in self._headers.items():
            turned = "turned upright as EXIF says" if self._upright[name] else "not turned as EXIF says, as in COLMAP"
            phrases[name] = [*header.conversions, *([f"images are {turned}"] if header.orientation != STORED else [])]
        return sentences(phrases)


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether one size is the other one resized, up to a pixel of rounding in the smaller one."""
    small, large = sorted((size, other))
    narrow, wide = (small[0] - 1) * large[1], (small[0] + 1) * large[1]
    return narrow <= large[0] * (small[1] + 1) and large[0] * (small[1] - 1) <= wide
