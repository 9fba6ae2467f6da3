"""Videos and images of known colors for tests."""

import struct
import zlib
from pathlib import Path
from typing import Any

import av
import numpy as np

COLORS = np.array(
    [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255), (0, 0, 0), (128, 128, 128), (200, 100, 50), (30, 180, 220)]
)
"""sRGB colors, 0..255."""
SIDE = 16
"""Size of a color's square in `write_colors`, pixels."""
LUMA = {
    1: (0.2126, 0.0722),
    2: (0.299, 0.114),
    5: (0.299, 0.114),
    6: (0.299, 0.114),
    7: (0.212, 0.087),
    9: (0.2627, 0.0593),
}
"""Weights of red and blue by matrix, from ITU-T H.273; undeclared is BT.601."""


def ycbcr(signal: np.ndarray, matrix: int, full: bool, bits: int) -> np.ndarray:
    """Return Y'CbCr codes [N, 3] of R'G'B' [N, 3] 0..1 by the definition in ITU-T H.273."""
    red, blue = LUMA[matrix]
    luma = signal @ [red, 1 - red - blue, blue]
    cb, cr = (signal[:, 2] - luma) / (2 - 2 * blue), (signal[:, 0] - luma) / (2 - 2 * red)
    top, unit = (1 << bits) - 1, 1 << (bits - 8)
    codes = (
        [luma * top, cb * top + 128 * unit, cr * top + 128 * unit]
        if full
        else [(219 * luma + 16) * unit, (224 * cb + 128) * unit, (224 * cr + 128) * unit]
    )
    return np.clip(np.rint(np.stack(codes, 1)), 0, top).astype(np.uint8 if bits == 8 else np.uint16)


def write_colors(
    path: Path,
    signal: np.ndarray,
    color: tuple[int, int, int] = (1, 2, 2),
    *,
    full: bool = False,
    bits: int = 8,
    frames: int = 2,
    lines: int = SIDE,
    options: dict[str, str] | None = None,
) -> Path:
    """Write a lossless 4:4:4 video with a square of each color R'G'B' [N, 3] 0..1 beside the other.

    `color` declares the matrix, the primaries and the transfer function.
    """
    matrix, primaries, transfer = color
    codes = np.repeat(ycbcr(signal, matrix, full, bits).T[:, None], SIDE, 2).repeat(lines, 1)
    with av.open(str(path), "w", options=options or {}) as container:
        stream: Any = container.add_stream("libx264", rate=30, options={"qp": "0", "preset": "ultrafast"})
        stream.height, stream.width = codes.shape[1:]
        stream.pix_fmt = "yuv444p" if bits == 8 else "yuv444p10le"
        context = stream.codec_context
        context.colorspace, context.color_range = matrix, 2 if full else 1
        context.color_primaries, context.color_trc = primaries, transfer
        for _ in range(frames):
            frame = av.VideoFrame(stream.width, stream.height, stream.pix_fmt)
            for plane, values in zip(frame.planes, codes, strict=True):
                padded = np.zeros((lines, plane.line_size // values.itemsize), values.dtype)
                padded[:, : values.shape[1]] = values
                plane.update(padded.tobytes())
            frame.colorspace, frame.color_range = matrix, 2 if full else 1
            frame.color_primaries, frame.color_trc = primaries, transfer
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def squares(image: np.ndarray) -> np.ndarray:
    """Return the color in the middle of each square of `write_colors`, [N, 3]."""
    return image[SIDE // 2, SIDE // 2 :: SIDE].astype(int)


def write_display_matrix(path: Path, matrix: tuple[int, int, int, int]) -> None:
    """Overwrite the linear part of the display matrix in an MP4 file's first track."""
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 44
    a, b, c, d = (value << 16 for value in matrix)
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(data)


def write_png16(path: Path, image: np.ndarray) -> None:
    """Write a PNG file with 16 bits per channel: gray [H, W] or color [H, W, 2..4] uint16."""
    kind = {1: 0, 2: 4, 3: 2, 4: 6}[1 if image.ndim == 2 else image.shape[2]]
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in image)
    header = struct.pack(">IIBBBBB", image.shape[1], image.shape[0], 16, kind, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in chunks))


def png_chunk(name: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG file."""
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def display_p3_profile() -> bytes:
    """Return an ICC profile of Display P3: its primaries adapted to D50, and the curve of sRGB."""

    def xyz(*values: float) -> bytes:
        return b"XYZ \0\0\0\0" + struct.pack(">3i", *(round(65536 * value) for value in values))

    curve = struct.pack(">5i", *(round(65536 * v) for v in (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)))
    tags = {
        b"wtpt": xyz(0.9642, 1.0, 0.8249),
        b"rXYZ": xyz(0.51512, 0.2412, -0.00105),
        b"gXYZ": xyz(0.29198, 0.69225, 0.04189),
        b"bXYZ": xyz(0.1571, 0.06657, 0.78407),
        **dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), b"para\0\0\0\0\0\3\0\0" + curve),
    }
    table, data, at = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    for name, value in tags.items():
        table += struct.pack(">4s2I", name, at + len(data), len(value))
        data += value + bytes(-len(value) % 4)
    head = struct.pack(
        ">I4sI4s4s4s12x4s4x4x4x4x8xI3i",
        at + len(data),
        b"\0" * 4,
        0x04000000,
        b"mntr",
        b"RGB ",
        b"XYZ ",
        b"acsp",
        0,
        63190,
        65536,
        54061,
    )
    return head.ljust(128, b"\0") + table + data
