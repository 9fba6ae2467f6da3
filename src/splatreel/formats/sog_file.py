"""Reader of SOG version 2, PlayCanvas's format: attributes as lossless WebP images, scales and colors by codebooks.

Source:
    https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatreel.base.archives import naming_damage, read_member
from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, allowed_memory, points_memory
from splatreel.base.untrusted import numbers, parse_json, read_file
from splatreel.formats.ply_table import Columns

META = "meta.json"
MOST_POINTS, MOST_BYTES = 1 << 26, 1 << 30
META_BYTES, META_VALUES = 4 << 20, 100_000
"""Maximum size of a meta.json, and number of its JSON values."""
_BANDS = {1: 3, 2: 8, 3: 15}
"""Coefficients per channel by SH degree."""
_PALETTE = 64
"""Centroids of view-dependent color per row of their image."""
_PIXEL = 10
"""Bytes of memory that decoding a pixel takes."""

Load = Callable[[str], bytes]


@dataclass(frozen=True)
class _Package:
    """Files of a scene. `load` returns one of them by its name; `size` is the bytes of all together."""

    path: Path
    load: Load
    size: int


def read_sog(path: Path, budget: MemoryBudget = UNRAISED) -> Columns:
    """Return columns as in a 3DGS PLY file, with logarithms of scales and logits of opacities.

    Args:
        path: A .sog file, or the meta.json of an unpacked one.
        budget: Memory that reading may take.

    Raises:
        GaussiansError: The file is damaged, of another version, or takes too much memory.
    """
    with _opened(path) as package:
        return _Sog(package, budget).columns()


def is_sog_antialiased(path: Path) -> bool:
    """Return whether the points are marked as trained with antialiasing. Raises as `read_sog` does."""
    with _opened(path) as package:
        meta = _read_meta(package)
        return meta.get("antialias") is True or meta.get("model") == "antialiased"


@contextmanager
def _opened(path: Path) -> Iterator[_Package]:
    """Open the files of a scene. Any fault of them is raised as `GaussiansError`."""
    with naming_damage(str(path), GaussiansError, "a damaged SOG file", "Export it again."):
        if path.name == META:
            folder = path.parent
            size = sum(file.stat().st_size for file in (path, *folder.glob("*.webp")))
            yield _Package(path, lambda name: read_file(folder / Path(name).name, MOST_BYTES, GaussiansError), size)
            return
        with zipfile.ZipFile(path) as archive:
            yield _Package(path, lambda name: _member(archive, name), path.stat().st_size)


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    info = archive.getinfo(name)
    most = META_BYTES if name == META else MOST_BYTES
    if info.file_size > most or (name != META and info.file_size > allowed_memory(info.compress_size)):
        raise ValueError(f"{name} has {info.file_size:,} bytes")
    return read_member(archive, info)


def _read_meta(package: _Package) -> dict[str, Any]:
    text = package.load(META)
    if len(text) > META_BYTES:
        raise ValueError(f"{META} has {len(text):,} bytes")
    meta = parse_json(text, GaussiansError, f"{package.path}: {META}", META_VALUES)
    version = meta.get("version") if isinstance(meta, dict) else None
    if version != 2:
        raise GaussiansError(
            f"{package.path}: is a SOG file of version {version or 1!r:.20}, only 2 is read. Convert it with splat-transform."
        )
    return meta


class _Sog:
    def __init__(self, package: _Package, budget: MemoryBudget) -> None:
        self._package, self._budget = package, budget
        self._meta = _read_meta(package)
        self._count = self._meta["count"]
        if not isinstance(self._count, int) or not 0 <= self._count <= MOST_POINTS:
            raise ValueError(f"{self._count!r:.20} points")
        degree = self._meta["shN"]["bands"] if "shN" in self._meta else 0
        coefficients = 3 * _BANDS[degree] if degree else 0
        self._check(points_memory(self._count, coefficients), f"{self._count:,} points of degree {degree}")

    def _check(self, needed: int, claim: str) -> None:
        self._budget.check(self._package.size + needed, self._package.size, str(self._package.path), claim)

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
        pixels = self._decode(entry["files"][0])
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
        pixels = self._decode(self._meta[name]["files"][file]).reshape(-1, 4)
        if len(pixels) < self._count:
            raise ValueError(f"{name} has {len(pixels)} of {self._count} points")
        return pixels[: self._count]

    def _decode(self, name: str) -> np.ndarray:
        """Return a WebP image as [H, W, 4] uint8."""
        data = self._package.load(name)
        width, height = _webp_size(data)
        self._check(_PIXEL * width * height, f"{name} of {width:,} x {height:,} pixels")
        try:
            with Image.open(io.BytesIO(data), formats=["WEBP"]) as image:
                if image.size != (width, height):
                    raise ValueError(f"{name} states two sizes")
                return np.asarray(image.convert("RGBA"))
        except Image.DecompressionBombError as error:
            raise ValueError(str(error)) from error


def _webp_size(data: bytes) -> tuple[int, int]:
    """Return width and height of a WebP image from its header, because Pillow allocates the image when it opens it.

    Source:
        WebP container specification (RFC 9649), sections 2.5 to 2.7.
    """
    kind, body = data[12:16], data[20:30]
    if len(body) < 10 or data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        raise ValueError("an image that is not WebP")
    if kind == b"VP8X":
        return 1 + int.from_bytes(body[4:7], "little"), 1 + int.from_bytes(body[7:10], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(body[1:5], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    return int.from_bytes(body[6:8], "little") & 0x3FFF, int.from_bytes(body[8:10], "little") & 0x3FFF
