"""Values of points as 8-bit images in HEVC tracks of an MP4 file, through PyAV's libx265.

The images are maps: values in Morton order within blocks, so that spatial neighbors are neighboring pixels.

Source:
    Paper, section 4.3.
"""

from __future__ import annotations

import io

import av
import numpy as np
from av.error import FFmpegError

from splatreel.base.errors import MissingDependencyError, ReelError
from splatreel.codec.mp4 import check_samples
from splatreel.codec.quantize import Parameters, integer

BLOCK = 16
"""Side of the blocks in pixels; widths and heights are multiples of it."""
_MIN_SIDE = 64
"""Side of one coding tree unit. x265 corrupts memory on images of 48 x 16 pixels."""
MAX_SLACK = 4096
"""Pixels that a map may have beyond its points."""


def size_of(count: int) -> tuple[int, int]:
    """Return width and height of the map of `count` points."""
    width = max(int(np.ceil(count**0.5 / BLOCK)) * BLOCK, _MIN_SIDE)
    return width, max(int(np.ceil(count / (width * BLOCK))) * BLOCK, _MIN_SIDE)


def decode_size(parameters: Parameters, count: int) -> tuple[int, int]:
    """Return the width and height that a section names. Raise `ReelError` if they do not fit `count` points."""
    width, height = (integer(parameters, side, BLOCK, 8192) for side in ("width", "height"))
    if width % BLOCK or height % BLOCK or not count <= width * height <= 2 * count + MAX_SLACK:
        raise ReelError(f"has maps of {width} x {height} pixels, which do not fit {count} points.")
    return width, height


def pixels_of(count: int, width: int) -> np.ndarray:
    """Return the pixel index [count] of each point in a map of the given width: Z-order in blocks, blocks boustrophedon."""
    index = np.arange(count)
    block, inside = index >> 8, index & 255
    x, y = _even_bits(inside), _even_bits(inside >> 1)
    row, column = np.divmod(block, width // BLOCK)
    column = np.where(row & 1, width // BLOCK - 1 - column, column)
    return (row * BLOCK + y) * width + column * BLOCK + x


def _even_bits(value: np.ndarray) -> np.ndarray:
    return (value & 1) | (value >> 1 & 2) | (value >> 2 & 4) | (value >> 3 & 8)


def to_maps(values: np.ndarray, pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return images [T, height, C * width] uint8 of values [T, N, C], one tile per channel, side by side."""
    frames, _, channels = values.shape
    maps = np.empty((frames, channels, height * width), np.uint8)
    maps[:] = values[:, -1, :, None]
    maps[:, :, pixels] = values.transpose(0, 2, 1)
    tiles = maps.reshape(frames, channels, height, width).transpose(0, 2, 1, 3)
    return np.ascontiguousarray(tiles.reshape(frames, height, channels * width))


def from_maps(maps: np.ndarray, pixels: np.ndarray, width: int) -> np.ndarray:
    """Return values [T, N, C] of images [T, height, C * width]."""
    frames, height, total = maps.shape
    tiles = maps.reshape(frames, height, total // width, width).transpose(0, 1, 3, 2)
    return np.ascontiguousarray(tiles).reshape(frames, height * width, -1)[:, pixels]


_X265 = (
    "keyint={frames}:min-keyint={frames}:scenecut=0:open-gop=0:bframes=0:repeat-headers=0:info=0:range=full:"
    "log-level=none:frame-threads=1:weightp=0:{rate}"
)
"""Parameters for one key image without reordering and for reproducible output.

Frame threads and weighted prediction are off, because they make the output depend on more than the input. Weighted
prediction reads uninitialized memory for small images: 60 encodings of the same 8 images of 96 x 32 gave 9 results.
"""

_LEVELS = ((36_864, 30), (122_880, 60), (245_760, 63), (552_960, 90), (983_040, 93), (2_228_224, 120), (8_912_896, 150))
"""Largest luma image and general_level_idc, from Table A.8 of H.265."""

MAX_PIXELS = 8_912_896
"""Luma pixels of the largest image that common decoders accept (level 5)."""
FPS = 30
"""Frames per second that the file states. Readers ignore it."""


def encode_tracks(tracks: list[tuple[str, np.ndarray, str]]) -> bytes:
    """Encode tracks into an MP4 file. The same images give the same bytes.

    Args:
        tracks: Name, images [T, H, W] uint8, and x265 rate control such as `lossless=1` or `crf=20` of each track.

    Raises:
        MissingDependencyError: PyAV has no libx265.
    """
    file = io.BytesIO()
    container = av.open(file, "w", format="mp4", options={"fflags": "+bitexact"})
    try:
        streams = [_add_stream(container, name, images, rate) for name, images, rate in tracks]
        for stream, (_, images, _) in zip(streams, tracks, strict=True):
            for index, image in enumerate(images):
                container.mux(stream.encode(_frame(image, index)))
            container.mux(stream.encode(None))
    finally:
        container.close()
    level = next(level for size, level in _LEVELS if max(p[0].size for _, p, _ in tracks) <= size)
    return _with_level(file.getvalue(), level)


def decode_tracks(data: bytes, count: int, frames: int, sizes: list[tuple[int, int]]) -> list[np.ndarray]:
    """Decode `count` tracks to images [frames, height, width] uint8 each.

    `sizes`: Width and height of each track.

    Raises:
        ReelError: The data is anything else.
    """
    check_samples(data, frames)
    return [_decode_track(data, track, count, frames, *sizes[track]) for track in range(count)]


def _add_stream(container, name: str, images: np.ndarray, rate: str):
    frames, height, width = images.shape
    if height * width > MAX_PIXELS:
        raise ReelError(f"Offset maps of {width} x {height} pixels are more than a video holds ({MAX_PIXELS} pixels).")
    try:
        stream = container.add_stream("libx265", rate=FPS)
    except (ValueError, FFmpegError) as error:
        raise MissingDependencyError("PyAV has no libx265 encoder. Install the `av` wheel from PyPI.") from error
    stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
    stream.options = {"x265-params": _X265.format(frames=max(frames, 1), rate=rate), "preset": "medium"}
    stream.codec_context.codec_tag = "hvc1"
    stream.metadata["handler_name"] = name
    return stream


def _frame(image: np.ndarray, index: int) -> av.VideoFrame:
    height, width = image.shape
    frame = av.VideoFrame(width, height, "yuv420p")
    luma, *chroma = frame.planes
    rows = np.zeros((luma.height, luma.line_size), np.uint8)
    rows[:height, :width] = image
    luma.update(rows.tobytes())
    for plane in chroma:
        plane.update(b"\x80" * plane.buffer_size)
    frame.pts = index
    return frame


def _decode_track(data: bytes, track: int, count: int, frames: int, width: int, height: int) -> np.ndarray:
    images = np.empty((frames, height, width), np.uint8)
    decoded = 0
    try:
        with av.open(io.BytesIO(data), "r", format="mov") as container:
            streams = container.streams.video
            if len(streams) != count:
                raise ReelError(f"holds {len(streams)} video tracks, expected {count}.")
            context = streams[track].codec_context
            if context is None or context.name != "hevc":
                raise ReelError(f"track {track} is not HEVC.")
            context.options = {"max_pixels": str(2 * (width + 64) * (height + 64))}
            context.thread_type = "NONE"
            for frame in container.decode(streams[track]):
                if decoded == frames or (frame.width, frame.height) != (width, height):
                    raise ReelError(
                        f"track {track} has an image {decoded} of {frame.width} x {frame.height} pixels; "
                        f"expected {frames} images of {width} x {height}."
                    )
                if not frame.format.name.startswith(("yuv420p", "yuvj420p")) or frame.format.components[0].bits != 8:
                    raise ReelError(f"track {track} has images of format {frame.format.name}, expected yuv420p.")
                luma = frame.planes[0]
                rows = np.frombuffer(luma, np.uint8)  # pyright: ignore[reportCallIssue, reportArgumentType]: it is a buffer
                images[decoded] = rows.reshape(-1, luma.line_size)[:height, :width]
                decoded += 1
    except (FFmpegError, ValueError, EOFError) as error:
        raise ReelError(f"is not a video file that can be decoded ({error}).") from error
    if decoded != frames:
        raise ReelError(f"track {track} holds {decoded} images, expected {frames}.")
    return images


def _with_level(data: bytes, level: int) -> bytes:
    """Write general_level_idc into every hvcC box and its VPS and SPS.

    x265 marks lossless streams as level 8.5, which hardware decoders refuse, and ignores a level given for them.
    """
    out = bytearray(data)
    box = out.find(b"hvcC")
    while box >= 0:
        end = box - 4 + int.from_bytes(out[box - 4 : box], "big")
        start = box + 4
        out[start + 12] = level
        at = start + 23
        for _ in range(out[start + 22]):
            kind, units = out[at] & 63, int.from_bytes(out[at + 1 : at + 3], "big")
            at += 3
            for _ in range(units):
                size = int.from_bytes(out[at : at + 2], "big")
                at += 2
                if kind in _LEVEL_BYTE:
                    out[_raw_position(out, at, _LEVEL_BYTE[kind])] = level
                at += size
        box = out.find(b"hvcC", end)
    return bytes(out)


_LEVEL_BYTE = {32: 17, 33: 14}
"""Position of general_level_idc in a VPS (NAL type 32) and an SPS (33), not counting emulation prevention bytes."""


def _raw_position(data: bytearray, start: int, index: int) -> int:
    """Return the position of byte `index` of the NAL unit at `start`, skipping emulation prevention bytes."""
    zeros = 0
    at = start
    while True:
        if zeros >= 2 and data[at] == 3:
            zeros = 0
        elif index == 0:
            return at
        else:
            index -= 1
            zeros = zeros + 1 if data[at] == 0 else 0
        at += 1
