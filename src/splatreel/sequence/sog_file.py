"""Reader of SOG version 2, PlayCanvas's format: attributes as lossless WebP images, scales and colors by codebooks.

Source:
    https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/
"""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatreel.errors import GaussiansError
from splatreel.scene.ply_table import Columns
from splatreel.scene.untrusted import numbers, parse_json, read_file

META = "meta.json"
MOST_POINTS, MOST_BYTES = 1 << 26, 1 << 30
_BANDS = {1: 3, 2: 8, 3: 15}
"""Coefficients per channel by SH degree."""
_PALETTE = 64
"""Centroids of view-dependent color per row of their image."""

Load = Callable[[str], bytes]


def read_sog(path: Path) -> Columns:
    """Return columns as in a 3DGS PLY file, with logarithms of scales and logits of opacities.

    Args:
        path: A .sog file, or the meta.json of an unpacked one.

    Raises:
        GaussiansError: The file is damaged, or of another version.
    """
    try:
        if path.name == META:
            return _Sog(
                path, lambda name: read_file(path.parent / Path(name).name, MOST_BYTES, GaussiansError)
            ).columns()
        with zipfile.ZipFile(path) as archive:
            return _Sog(path, lambda name: _member(archive, name)).columns()
    except OSError as error:
        raise GaussiansError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except (KeyError, IndexError, TypeError, ValueError, EOFError, NotImplementedError, RuntimeError) as error:
        raise GaussiansError(f"{path}: is a damaged SOG file ({error!s:.80}). Export it again.") from error
    except (zipfile.BadZipFile, zlib.error, Image.DecompressionBombError) as error:
        raise GaussiansError(f"{path}: is a damaged SOG file ({error!s:.80}). Export it again.") from error


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    info = archive.getinfo(name)
    if info.file_size > MOST_BYTES:
        raise ValueError(f"{name} has {info.file_size:,} bytes")
    return archive.read(info)


class _Sog:
    def __init__(self, path: Path, load: Load) -> None:
        self._load = load
        meta = parse_json(load(META), GaussiansError, f"{path}: {META}")
        version = meta.get("version") if isinstance(meta, dict) else None
        if version != 2:
            raise GaussiansError(
                f"{path}: is a SOG file of version {version or 1!r:.20}, only 2 is read. Convert it with splat-transform."
            )
        self._meta: dict[str, Any] = meta
        self._count = meta["count"]
        if not isinstance(self._count, int) or not 0 <= self._count <= MOST_POINTS:
            raise ValueError(f"{self._count!r:.20} points")

    def columns(self) -> Columns:
        quats = self._image("quats", 0)
        small = (quats[:, :3] / 255 - 0.5) * np.sqrt(2)
        place = quats[:, 3].astype(np.int64) - 252
        if (place < 0).any():
            raise ValueError("a rotation without its largest number")
        turns = np.empty((self._count, 4))
        for part in range(4):
            before = np.clip(part - (place < part), 0, 2)
            rest = np.sqrt(np.maximum(1 - (small**2).sum(1), 0))
            turns[:, part] = np.where(place == part, rest, small[np.arange(self._count), before])
        color = self._image("sh0", 0)
        with np.errstate(divide="ignore"):
            opacity = np.log(color[:, 3] / 255) - np.log1p(-(color[:, 3] / 255))
        scales = self._codebook("scales")[self._image("scales", 0)[:, :3]]
        base = self._codebook("sh0")[color[:, :3]]
        found = dict(zip("xyz", self._means().T, strict=True)) | {"opacity": opacity}
        found |= {f"rot_{i}": turns[:, i] for i in range(4)}
        found |= {f"scale_{i}": scales[:, i] for i in range(3)} | {f"f_dc_{i}": base[:, i] for i in range(3)}
        return found | (self._rest() if "shN" in self._meta else {})

    def _means(self) -> np.ndarray:
        """Return positions [N, 3], stored as 16 bits of their signed logarithms."""
        low, high = (numbers(self._meta["means"][end], 3) for end in ("mins", "maxs"))
        share = (self._image("means", 0)[:, :3] + 256.0 * self._image("means", 1)[:, :3]) / 65535
        values = low + (high - low) * share
        return np.sign(values) * np.expm1(np.minimum(np.abs(values), 80))

    def _rest(self) -> Columns:
        """Return the columns of view-dependent color, by each point's centroid."""
        entry = self._meta["shN"]
        bands = _BANDS[entry["bands"]]
        pixels = _decode(self._load(entry["files"][0]))
        if pixels.shape[1] != _PALETTE * bands:
            raise ValueError(f"centroids {pixels.shape[1]} pixels wide")
        labels = self._image("shN", 1)[:, :2].astype(np.int64) @ [1, 256]
        palette = pixels[..., :3].reshape(-1, bands, 3)
        values = self._codebook("shN")[palette[labels]]
        return {f"f_rest_{bands * channel + i}": values[:, i, channel] for channel in range(3) for i in range(bands)}

    def _codebook(self, name: str) -> np.ndarray:
        return numbers(self._meta[name]["codebook"], 256)

    def _image(self, name: str, file: int) -> np.ndarray:
        """Return the pixels [count, 4] of one of an attribute's images."""
        pixels = _decode(self._load(self._meta[name]["files"][file])).reshape(-1, 4)
        if len(pixels) < self._count:
            raise ValueError(f"{name} has {len(pixels)} of {self._count} points")
        return pixels[: self._count]


def _decode(data: bytes) -> np.ndarray:
    """Return a WebP image as [H, W, 4] uint8."""
    with Image.open(io.BytesIO(data), formats=["WEBP"]) as image:
        if image.width * image.height > MOST_POINTS:
            raise ValueError(f"an image of {image.width} x {image.height} pixels")
        return np.asarray(image.convert("RGBA"))
