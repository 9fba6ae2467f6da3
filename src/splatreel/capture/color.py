"""Meaning of pixel values, and their conversion to 8-bit sRGB."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import av
import numpy as np
from av.video.reformatter import Interpolation

from splatreel.base.errors import CaptureError
from splatreel.base.progress import listed
from splatreel.capture.orientation import Orientation

BT2020, P3 = 9, 12
"""Primaries of wide gamuts, by their numbers in ITU-T H.273."""
PQ, HLG = 16, 18
"""Transfer functions of high dynamic range, by their numbers in ITU-T H.273."""
TO_SRGB = {
    BT2020: [[1.660491, -0.587641, -0.072850], [-0.124550, 1.132900, -0.008349], [-0.018151, -0.100579, 1.118730]],
    P3: [[1.224940, -0.224940, 0.0], [-0.042057, 1.042057, 0.0], [-0.019638, -0.078636, 1.098274]],
}
"""Matrices from linear light of a wide gamut to that of sRGB, all with the white D65."""
REFERENCE_WHITE = 203.0
"""Luminance of white in PQ, cd/m^2. Source: ITU-R BT.2408."""
HLG_WHITE = 0.75
"""Signal of white in HLG. Source: ITU-R BT.2408."""
FULL = 255 << 8
"""Largest R'G'B' value that FFmpeg makes of Y'CbCr with 16 bits per channel."""
STEPS = 1 << 14
"""Steps of linear light from black to white, fine enough for 8 bits of sRGB in the dark."""
ROWS = 16
"""Rows converted at a time, which fit into a processor's cache."""


class SrgbConversion:
    """Conversion of FFmpeg's 16-bit R'G'B' to 8-bit sRGB.

    Light above white and colors outside sRGB are clipped, as by the sensor of a camera that records sRGB.

    Args:
        primaries: Primaries of the input, 0 for those of sRGB.
        transfer: PQ, HLG, or 0 for the transfer function of sRGB, which stands for those of all SDR videos.
    """

    def __init__(self, primaries: int, transfer: int) -> None:
        signal = np.minimum(np.arange(1 << 16) / FULL, 1)
        light = pq_light(signal) if transfer == PQ else hlg_light(signal) if transfer == HLG else srgb_light(signal)
        self._light = (light * (STEPS - 1)).astype(np.float32)
        self._matrix = np.array(TO_SRGB.get(primaries, np.eye(3)), np.float32).T
        self._codes = np.rint(255 * srgb_signal(np.linspace(0, 1, STEPS))).astype(np.uint8)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Convert [H, W, 3] uint16 to uint8."""
        out = np.empty(image.shape, np.uint8)
        for row in range(0, len(image), ROWS):
            part = image[row : row + ROWS]
            light = self._light[part].reshape(-1, 3) @ self._matrix
            light += 0.5
            np.clip(light, 0, STEPS - 1, out=light)
            out[row : row + ROWS] = self._codes[light.astype(np.uint16)].reshape(part.shape)
        return out


@lru_cache(maxsize=8)
def srgb_conversion(primaries: int, transfer: int) -> SrgbConversion:
    """Return the conversion of these primaries and this transfer function."""
    return SrgbConversion(primaries, transfer)


def srgb_light(signal: np.ndarray) -> np.ndarray:
    """Return the linear light of an sRGB signal, both 0..1."""
    return np.where(signal <= 0.04045, signal / 12.92, ((signal + 0.055) / 1.055) ** 2.4)


def srgb_signal(light: np.ndarray) -> np.ndarray:
    """Return the sRGB signal of linear light, both 0..1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def hlg_light(signal: np.ndarray) -> np.ndarray:
    """Return the light in front of the camera for an HLG signal 0..1, relative to white.

    Source: ITU-R BT.2100, table 5, inverse of the OETF.
    """

    def scene(value: np.ndarray) -> np.ndarray:
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        return np.where(value <= 0.5, value**2 / 3, (np.exp((value - c) / a) + b) / 12)

    return scene(signal) / scene(np.array(HLG_WHITE))


def pq_light(signal: np.ndarray) -> np.ndarray:
    """Return the light of a screen for a PQ signal 0..1, relative to white. Source: ITU-R BT.2100, table 4, EOTF."""
    m1, m2, c1, c2, c3 = 1305 / 8192, 2523 / 32, 107 / 128, 2413 / 128, 2392 / 128
    root = signal ** (1 / m2)
    return (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1) * (10000 / REFERENCE_WHITE)


def over_black(image: np.ndarray) -> np.ndarray:
    """Return straight alpha [H, W, 4] uint8 or uint16 composed over black, [H, W, 3]."""
    return over_color(image[..., :3], image[..., 3], (0, 0, 0))


def over_color(image: np.ndarray, alpha: np.ndarray, color: Sequence[int] | np.ndarray) -> np.ndarray:
    """Compose an image over a color. sRGB values are blended, as in 3DGS.

    Args:
        image: [H, W, 3] uint8 or uint16, straight.
        alpha: [H, W] of the same type.
        color: Red, green and blue of the same range.
    """
    full = np.iinfo(image.dtype).max
    if alpha.min(initial=full) == full:
        return image
    alpha = alpha[..., None].astype(np.uint32)
    behind = (full - alpha) * np.asarray(color, np.uint32)
    return ((image * alpha + behind + full // 2) // full).astype(image.dtype)


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
    return [
        f"{'all cameras' if len(names) == len(phrases) else listed(names)}: {phrase}"
        for phrase, names in cameras.items()
    ]
