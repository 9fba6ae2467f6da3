"""Videos with sound for tests."""

from pathlib import Path
from typing import Any

import av
import numpy as np

HEARD = 44100
"""Sound samples per second of `film`."""


def film(
    path: Path, sound: np.ndarray | None, seconds: float = 4, late: float = 0.0, codec: str = "aac", rate: int = 10
) -> None:
    """Write a black video of `rate` frames per second, with sound [samples] or [samples, 2] that starts `late` seconds later."""
    with av.open(str(path), "w") as container:
        images = container.add_stream("libx264", rate=rate)
        images.width, images.height, images.pix_fmt = 32, 32, "yuv420p"
        columns = None if sound is None else np.atleast_2d(sound.T)
        layout = "stereo" if columns is not None and len(columns) > 1 else "mono"
        track: Any = container.add_stream(codec, rate=HEARD, layout=layout) if columns is not None else None
        for _ in range(round(rate * seconds)):
            container.mux(images.encode(av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8), format="rgb24")))
        container.mux(images.encode(None))
        if track is None or columns is None:
            return
        format = "fltp" if codec == "aac" else "s16"
        for at in range(0, columns.shape[1] - 1023, 1024):
            part = np.clip(columns[:, at : at + 1024], -1, 1).astype(np.float32)
            if format == "s16":
                part = np.rint(part.T.reshape(1, -1) * 32767).astype(np.int16)
            frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(part), format=format, layout=layout)  # pyright: ignore[reportArgumentType]
            frame.sample_rate, frame.pts = HEARD, at + round(late * HEARD)
            container.mux(track.encode(frame))
        container.mux(track.encode(None))
