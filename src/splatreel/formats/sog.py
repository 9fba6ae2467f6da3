"""Gaussians as SOG version 2, PlayCanvas's format: lossless WebP images in a zip archive.

Positions are 16 bits of signed logarithms. Scales and base colors are indices into codebooks of 256 numbers. A point's
view-dependent color is an entry of a palette.

Source:
    https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, allowed_memory, points_memory
from splatreel.base.ply_table import Columns
from splatreel.base.untrusted import check_regular, naming_damage, numbers, parse_json, read_file, read_member
from splatreel.formats.compressed_ply import from_smallest_three, smallest_three
from splatreel.formats.splat import to_bytes
from splatreel.formats.splat_columns import logit, name_columns
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.morton import neighbor_order

CODEBOOK, ROUNDS = 256, 20
"""Numbers of a codebook, and rounds of k-means that find them."""
COLUMNS, MOST_LEVELS = 64, 16
"""Palette entries per row of their image, and the logarithm of the largest palette."""
_BINS = 4096
_EFFORT = 75
"""Effort of lossless WebP, 0 to 100. More takes thirty times as long for the same bytes."""
_ZIP_TIME = (1980, 1, 1, 0, 0, 0)

_Meta = dict[str, Any]
Files = dict[str, bytes]


def write_sog(path: str | Path, gaussians: Gaussians, antialias: bool = False) -> None:
    """Write a SOG file atomically.

    Args:
        path: Output file.
        gaussians: Gaussians to write, with the axes of a PLY file.
        antialias: Value of the antialiasing flag, as for `render_image`.

    Raises:
        StorageError: The file cannot be written.
    """
    points = gaussians[neighbor_order(gaussians.means)]
    files: Files = {}
    meta: _Meta = {"version": 2, "asset": {"generator": "Splatreel"}, "count": len(points), "antialias": antialias}
    meta |= {"model": "antialiased"} if antialias else {}  # the name of splat-transform 3
    meta["means"] = _add_means(points.means, files)
    meta["scales"] = _add_indices("scales", np.log(np.maximum(points.scales, 1e-30)), files)
    place, others = smallest_three(points.quats)
    files["quats.webp"] = _image(np.concatenate([to_bytes(255 * others), (252 + place[:, None]).astype(np.uint8)], 1))
    meta["quats"] = {"files": ["quats.webp"]}
    meta["sh0"] = _add_indices("sh0", points.sh[:, 0], files, to_bytes(255 * points.opacities[:, None]))
    if points.sh.shape[1] > 1 and len(points):
        meta["shN"] = _add_palette(points.sh[:, 1:], files)
    files["meta.json"] = json.dumps(meta).encode()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name, _ZIP_TIME), data)
    write_bytes(Path(path), packed.getvalue())


def _add_means(means: np.ndarray, files: Files) -> _Meta:
    values = np.sign(means) * np.log1p(np.abs(means.astype(np.float64)))
    low, high = (values.min(0), values.max(0)) if len(values) else (np.zeros(3), np.zeros(3))
    words = np.rint(65535 * (values - low) / np.maximum(high - low, 1e-30)).astype(np.int64)
    files["means_l.webp"], files["means_u.webp"] = _image(_opaque(words & 255)), _image(_opaque(words >> 8))
    return {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]}


def _add_indices(name: str, values: np.ndarray, files: Files, alpha: np.ndarray | None = None) -> _Meta:
    """Add the image of an attribute [N, 3], stored as indices into a codebook. `alpha` [N, 1] is its fourth channel."""
    codebook, indices = _codebook(values)
    files[f"{name}.webp"] = _image(_opaque(indices) if alpha is None else np.concatenate([indices, alpha], 1))
    return {"codebook": codebook.tolist(), "files": [f"{name}.webp"]}


def _add_palette(rest: np.ndarray, files: Files) -> _Meta:
    """Add view-dependent colors [N, K, 3]: an image of the palette, of K pixels per entry, and an image of indices into it."""
    count, bands, _ = rest.shape
    labels, centers = _palette(rest.reshape(count, -1))
    codebook, indices = _codebook(centers)
    rows = -(-len(centers) // COLUMNS)
    pixels = np.zeros((rows * COLUMNS, bands, 3), np.uint8)
    pixels[: len(centers)] = indices.reshape(-1, bands, 3)
    files["shN_centroids.webp"] = _webp(_opaque(pixels.reshape(-1, 3)).reshape(rows, COLUMNS * bands, 4))
    files["shN_labels.webp"] = _image(_opaque(np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], 1)))
    degree = {3: 1, 8: 2, 15: 3}[bands]
    names = ["shN_centroids.webp", "shN_labels.webp"]
    return {"count": len(centers), "bands": degree, "codebook": codebook.tolist(), "files": names}


def _codebook(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers [256] that represent values best, and the index of each value, uint8, by one-dimensional k-means.

    The start follows the cube root of the density, which is optimal for many numbers.
    """
    flat = np.sort(values.ravel().astype(np.float64))
    if not len(flat):
        return np.zeros(CODEBOOK), values.astype(np.uint8)
    counts, edges = np.histogram(flat, _BINS)
    mass = np.concatenate([[0.0], np.cumsum(np.cbrt(counts))])
    centers = np.interp((np.arange(CODEBOOK) + 0.5) * mass[-1] / CODEBOOK, mass, edges)
    sums = np.concatenate([[0.0], np.cumsum(flat)])
    for _ in range(ROUNDS):
        ends = np.searchsorted(flat, np.concatenate([[-np.inf], _borders(centers), [np.inf]]))
        sizes = np.diff(ends)
        centers = np.where(sizes > 0, np.diff(sums[ends]) / np.maximum(sizes, 1), centers)
        centers.sort()
    return centers, np.searchsorted(_borders(centers), values).astype(np.uint8)


def _borders(centers: np.ndarray) -> np.ndarray:
    return (centers[1:] + centers[:-1]) / 2


def _palette(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the palette entry of each vector, [N], and the entries [P, D]: means of cells that were halved again and again.

    A cell is halved at the median of its most varied dimension.
    """
    count = len(vectors)
    levels = min(MOST_LEVELS, int(np.log2(count)) if count > 1 else 0)
    labels = np.zeros(count, np.int64)
    for level in range(levels):
        cells = 1 << level
        sizes = np.maximum(np.bincount(labels, minlength=cells), 1)[:, None]
        means, squares = (_sums(part, labels, cells) / sizes for part in (vectors, vectors**2))
        widest = (squares - means**2).argmax(1)
        order = np.lexsort((vectors[np.arange(count), widest[labels]], labels))
        starts = np.concatenate([[0], np.cumsum(np.bincount(labels, minlength=cells))[:-1]])
        place = np.empty(count, np.int64)
        place[order] = np.arange(count) - starts[labels[order]]
        labels = 2 * labels + (2 * place >= sizes[labels, 0])
    used, labels = np.unique(labels, return_inverse=True)
    return labels, _sums(vectors, labels, len(used)) / np.bincount(labels)[:, None]


def _sums(values: np.ndarray, labels: np.ndarray, cells: int) -> np.ndarray:
    return np.stack([np.bincount(labels, column, cells) for column in values.T], 1)


def _opaque(values: np.ndarray) -> np.ndarray:
    """Return RGB values [N, 3] as RGBA bytes [N, 4]."""
    return np.concatenate([values.astype(np.uint8), np.full((len(values), 1), 255, np.uint8)], 1)


def _image(pixels: np.ndarray) -> bytes:
    """Return RGBA pixels [N, 4] as a nearly square image whose sides are multiples of four."""
    width = max(4 * int(np.ceil(np.sqrt(len(pixels)) / 4)), 4)
    height = max(4 * -(-len(pixels) // (4 * width)), 4)
    padded = np.zeros((width * height, 4), np.uint8)
    padded[: len(pixels)] = pixels
    return _webp(padded.reshape(height, width, 4))


def _webp(pixels: np.ndarray) -> bytes:
    """Return an image [H, W, 4] as lossless WebP that keeps colors where alpha is 0."""
    packed = io.BytesIO()
    Image.fromarray(pixels).save(packed, "WEBP", lossless=True, exact=True, quality=_EFFORT)
    return packed.getvalue()


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

    `path`: A .sog file, or the meta.json of an unpacked one.

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
        check_regular(path, GaussiansError)
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
        self._package = package
        self._budget = budget
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
        color = self._image("sh0", 0)
        scales = self._codebook("scales")[self._image("scales", 0)[:, :3]]
        base = self._codebook("sh0")[color[:, :3]]
        rest, opacity = self._rest() if "shN" in self._meta else None, logit(color[:, 3] / 255)
        return name_columns(self._means(), scales, from_smallest_three(place, small), base, opacity, rest)

    def _means(self) -> np.ndarray:
        """Return positions [N, 3], stored as 16 bits of their signed logarithms."""
        low, high = (numbers(self._meta["means"][end], 3) for end in ("mins", "maxs"))
        share = (self._image("means", 0)[:, :3] + 256.0 * self._image("means", 1)[:, :3]) / 65535
        values = low + (high - low) * share
        return np.sign(values) * np.expm1(np.minimum(np.abs(values), 80))

    def _rest(self) -> np.ndarray:
        """Return the coefficients of view-dependent color [N, bands, 3], by each point's centroid."""
        entry = self._meta["shN"]
        bands = _BANDS[entry["bands"]]
        pixels = self._decode(entry["files"][0])
        if pixels.shape[1] != _PALETTE * bands:
            raise ValueError(f"centroids {pixels.shape[1]} pixels wide")
        labels = self._image("shN", 1)[:, :2].astype(np.int64) @ [1, 256]
        palette = pixels[..., :3].reshape(-1, bands, 3)
        return self._codebook("shN")[palette[labels]]

    def _codebook(self, name: str) -> np.ndarray:
        return numbers(self._meta[name]["codebook"], 256)

    def _image(self, name: str, file: int) -> np.ndarray:
        """Return the pixels [count, 4] of one of an attribute's images."""
        pixels = self._decode(self._meta[name]["files"][file]).reshape(-1, 4)
        if len(pixels) < self._count:
            raise ValueError(f"{name} has {len(pixels)} of {self._count} points")
        return pixels[: self._count]

    def _decode(self, name: str) -> np.ndarray:
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
