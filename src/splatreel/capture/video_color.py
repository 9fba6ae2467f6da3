"""Meaning of a video's pixel values, and their conversion to sRGB."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import av
import numpy as np
from av.video.reformatter import Interpolation

from splatreel.base.errors import CaptureError
from splatreel.capture.orientation import Orientation
from splatreel.capture.srgb import BT2020, HLG, P3, PQ, over_black, srgb_conversion

UPSAMPLE_CHROMA = Interpolation.BICUBIC | Interpolation.FULL_CHR_H_INT | Interpolation.ACCURATE_RND
"""FFmpeg interpolates 4:2:0 chroma only on request. The default, repetition, costs 2 dB at saturated edges."""
UNDECLARED = 2
MATRICES = (0, 1, 2, 4, 5, 6, 7, 9)
"""Matrices between Y'CbCr and R'G'B' that FFmpeg converts. Others are not linear, or of YCgCo."""
SDR = (1, 2, 4, 5, 6, 7, 11, 12, 13, 14, 15)
"""Transfer functions whose signals are shown as sRGB, as FFmpeg, OpenCV and browsers do."""
LIKE_SRGB = (1, 2, 4, 5, 6, 7, 22)
"""Primaries close enough to those of sRGB that no program converts them."""
TRANSFERS = {"sdr": 1, "hlg": HLG, "pq": PQ}
"""Names of transfer functions in the sidecar."""
SD_LINES = 576
"""Maximum height of standard definition. Above it, players assume another matrix than FFmpeg and OpenCV."""


@dataclass(frozen=True)
class VideoColor:
    """Declaration of a video stream, with the numbers of ITU-T H.273.

    Attributes:
        pixels: FFmpeg's name of the pixel format.
        matrix: Matrix between Y'CbCr and R'G'B'.
        primaries: Colors of the primaries.
        transfer: Transfer function.
        is_interlaced: True if the lines of an image are declared to be of two moments.
    """

    pixels: str
    matrix: int = UNDECLARED
    primaries: int = UNDECLARED
    transfer: int = UNDECLARED
    is_interlaced: bool = False

    @property
    def bits(self) -> int:
        """Bits per channel."""
        return max(part.bits for part in av.VideoFormat(self.pixels).components)

    @property
    def has_alpha(self) -> bool:
        """True if pixels have an opacity."""
        return any(part.is_alpha for part in av.VideoFormat(self.pixels).components)

    @property
    def _is_yuv(self) -> bool:
        form = av.VideoFormat(self.pixels)
        return len(form.components) > 2 and not form.is_rgb

    @property
    def is_converted(self) -> bool:
        """True if the signal is not shown as sRGB as it is."""
        return self.transfer in (PQ, HLG) or self.primaries in (BT2020, P3)

    def interpreted(self, path: Path, transfer: str | None) -> VideoColor:
        """Return the declaration with defaults for what is missing.

        Args:
            path: Video, for messages.
            transfer: Transfer function of the sidecar, for videos that declare none, or None.

        Raises:
            CaptureError: The color cannot be converted, or is ambiguous.
        """
        unknown = self.transfer == UNDECLARED
        found = replace(self, transfer=TRANSFERS[transfer]) if unknown and transfer is not None else self
        if found.primaries == UNDECLARED and (found.matrix == BT2020 or found.transfer in (PQ, HLG)):
            found = replace(found, primaries=BT2020)
        if found.primaries == BT2020 and found.matrix == UNDECLARED:
            found = replace(found, matrix=BT2020)
        if found.primaries == BT2020 and found.transfer == UNDECLARED:
            raise CaptureError(
                f"{path}: declares BT.2020 colors but no transfer function, so that SDR, HLG, PQ and a camera's log are possible. "
                f'Write "transfer": "hlg" (or "pq", "sdr") into splatreel.json in the capture\'s folder, or convert log to BT.709.'
            )
        for name, value, read in (
            ("color matrix", found.matrix, MATRICES),
            ("transfer function", found.transfer, (*SDR, PQ, HLG)),
            ("primaries", found.primaries, (*LIKE_SRGB, BT2020, P3)),
        ):
            if value not in read:
                raise CaptureError(
                    f"{path}: its {name} (number {value} of ITU-T H.273) cannot be converted. Convert the video to BT.709."
                )
        return found

    def conversions(self, height: int) -> list[str]:
        """Return phrases for conversions of an interpreted declaration that users should know of.

        Args:
            height: Height of the images, pixels.
        """
        found = []
        if self.transfer in (PQ, HLG):
            name, white = ("PQ", "203 cd/m2") if self.transfer == PQ else ("HLG", "75 % of the signal")
            found.append(f"{name} is converted to sRGB, {white} becomes white and brighter light is clipped")
        elif self.is_converted:
            name = "BT.2020" if self.primaries == BT2020 else "Display P3"
            found.append(f"{name} colors are converted to sRGB")
        elif self.transfer == UNDECLARED and self.bits > 8:
            found.append(f"{self.bits} bits without a declared transfer function are read as SDR")
        if self.matrix == UNDECLARED and height > SD_LINES and self._is_yuv:
            found.append("no color matrix is declared, BT.601 is assumed as in FFmpeg and OpenCV")
        if self.is_interlaced:
            found.append(
                "marked as interlaced, read as stored; if moving edges look like combs, deinterlace with ffmpeg -vf bwdif"
            )
        return [*found, "transparent pixels are composed over black"] if self.has_alpha else found

    def to_rgb(self, frame: av.VideoFrame, width: int, height: int, orientation: Orientation) -> np.ndarray:
        """Return a decoded image upright as uint8 [height, width, 3] sRGB, resized by area to width x height."""
        width, height = orientation.size(width, height)
        shrinks = width < frame.width or height < frame.height
        interpolation = Interpolation.AREA if shrinks else UPSAMPLE_CHROMA
        if not self.is_converted:
            form = "rgba" if self.has_alpha else "rgb24"
            image = frame.reformat(width, height, form, interpolation=interpolation).to_ndarray()
            return orientation.apply(over_black(image) if self.has_alpha else image)
        form = "rgba64le" if self.has_alpha else "rgb48le"
        matrix = None if self.matrix in (0, UNDECLARED) else self.matrix
        image = frame.reformat(width, height, form, src_colorspace=matrix, interpolation=interpolation).to_ndarray()
        image = over_black(image) if self.has_alpha else image
        return orientation.apply(srgb_conversion(self.primaries, self.transfer)(image))


def declared_color(context: av.VideoCodecContext, first: av.VideoFrame | None) -> VideoColor:
    """Return the declaration of a stream from its decoder and its first image, if it could be decoded."""
    pixels = context.pix_fmt or "yuv420p"  # no image could be decoded
    numbers = int(context.colorspace), int(context.color_primaries) or 3, int(context.color_trc) or 3
    matrix, primaries, transfer = (UNDECLARED if number == 3 else number for number in numbers)  # 3 is reserved
    return VideoColor(pixels, matrix, primaries, transfer, first is not None and bool(first.interlaced_frame))


class ColoredVideo(Protocol):
    """Video with a declaration of its color."""

    path: Path
    height: int
    color: VideoColor


def video_conversions(videos: Mapping[str, ColoredVideo]) -> list[str]:
    """Return a sentence for each conversion of several cameras' videos, with the names of the cameras."""
    return sentences({name: video.color.conversions(video.height) for name, video in videos.items()})


def sentences(phrases: Mapping[str, Iterable[str]]) -> list[str]:
    """Return a sentence for each distinct phrase about cameras, with the names of the first cameras."""
    cameras: dict[str, list[str]] = {}
    for name, said in phrases.items():
        for phrase in said:
            cameras.setdefault(phrase, []).append(name)
    return [f"{_listed(names, len(phrases))}: {phrase}" for phrase, names in cameras.items()]


def _listed(names: list[str], total: int) -> str:
    if len(names) == total:
        return "all cameras"
    return ", ".join(names) if len(names) < 4 else f"{', '.join(names[:2])} and {len(names) - 2} others"
