"""Videos whose frames show their own numbers, in any container and codec."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

WIDTH, HEIGHT = 64, 48
COUNT = 40
"""Frames of a video; at most 256 can be distinguished."""

X264 = {"crf": "1", "preset": "ultrafast", "bf": "3", "b-adapt": "0", "g": "8", "sc_threshold": "0"}
X265 = "log-level=none:bframes=3:b-adapt=0:keyint=8:min-keyint=8:scenecut=0"
CODINGS = {
    "h264": ("libx264", X264),
    "h264 without B-frames": ("libx264", X264 | {"bf": "0"}),
    "h264 open GOPs": ("libx264", X264 | {"x264-params": "open-gop=1"}),
    "h264 intra refresh": ("libx264", X264 | {"bf": "0", "x264-params": "intra-refresh=1"}),
    "h264 one keyframe": ("libx264", X264 | {"g": "250"}),
    "h264 interlaced": ("libx264", X264 | {"flags": "+ildct+ilme"}),
    "hevc": ("libx265", {"preset": "ultrafast", "x265-params": f"{X265}:open-gop=0"}),
    "hevc open GOPs": ("libx265", {"preset": "ultrafast", "x265-params": f"{X265}:open-gop=1"}),
    "mpeg2": ("mpeg2video", {"bf": "2", "g": "8", "qmin": "1", "qmax": "2"}),
    "mpeg4": ("mpeg4", {"bf": "2", "g": "8", "qmin": "1", "qmax": "2"}),
    "vp9": ("libvpx-vp9", {"g": "8", "crf": "5", "b": "0", "deadline": "realtime", "cpu-used": "8"}),
}
"""Encoder and options by name."""


def make_image(number: int) -> np.ndarray:
    """Return an image [HEIGHT, WIDTH, 3] uint8 of eight blocks, the bits of a number."""
    image = np.full((HEIGHT, WIDTH, 3), 16, np.uint8)
    for bit in range(8):
        row, column = divmod(bit, 4)
        image[24 * row : 24 * row + 24, 16 * column : 16 * column + 16] += np.uint8(220 * (number >> bit & 1))
    return image


def number_of(image: np.ndarray) -> int:
    """Return the number in an image of `image`."""
    means = image.reshape(2, 24, 4, 16, 3)[:, 6:18, :, 4:12].mean((1, 3, 4)).ravel()
    return sum(int(mean > 126) << bit for bit, mean in enumerate(means))


def write_film(
    path: Path,
    coding: str = "h264",
    count: int = COUNT,
    times: list[int] | None = None,
    options: dict[str, str] | None = None,
    sound: bool = False,
) -> Path:
    """Write a video of 30 frames per second.

    Args:
        path: Output file; its suffix selects the container.
        coding: One of `CODINGS`.
        count: Number of frames.
        times: Time of each frame in units of 1/90000 s, instead of 30 frames per second.
        options: Options of the container.
        sound: Add a silent track.
    """
    encoder, settings = CODINGS[coding]
    form = "mpegts" if path.suffix == ".mts" else None
    with av.open(str(path), "w", format=form, options=options or {}) as container:
        stream: Any = container.add_stream(encoder, rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.options = settings
        stream.codec_context.gop_size = int(settings.get("g", 8))
        unit = Fraction(1, 30) if times is None else Fraction(1, 90000)
        stream.codec_context.time_base = unit
        track = container.add_stream("aac", rate=48000, layout="mono") if sound else None
        for number in range(count):
            frame = av.VideoFrame.from_ndarray(make_image(number), format="rgb24")
            frame.pts, frame.time_base = number if times is None else times[number], unit
            container.mux(stream.encode(frame))
            if track is not None:
                part = av.AudioFrame.from_ndarray(np.zeros((1, 1600), np.float32), format="fltp", layout="mono")
                part.sample_rate, part.pts = 48000, 1600 * number
                container.mux(track.encode(part))
        container.mux(stream.encode(None))
        if track is not None:
            container.mux(track.encode(None))
    return path
