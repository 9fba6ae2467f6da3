"""Gaussians as SOG version 2, PlayCanvas's format: lossless WebP images in a zip archive. `formats/sog_file.py` reads it.

Positions are 16 bits of signed logarithms. Scales and base colors are indices into codebooks of 256 numbers. A point's
view-dependent color is an entry of a palette.

Source:
    https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatreel.base.atomic import write_bytes
from splatreel.formats.compressed_ply import smallest_three
from splatreel.formats.splat import to_bytes
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

Meta = dict[str, Any]
Files = dict[str, bytes]


def write_sog(path: str | Path, gaussians: Gaussians, antialias: bool = False) -> None:
    """Write a SOG file atomically.

    Args:
        path: Output file.
        gaussians: Gaussians to write, with the axes of a PLY file.
        antialias: Value of the antialiasing flag, as for `render_image`.

    Raises:
        GaussiansError: The file cannot be written.
    """
    points = gaussians[neighbor_order(gaussians.means)]
    files: Files = {}
    meta: Meta = {"version": 2, "asset": {"generator": "Splatreel"}, "count": len(points), "antialias": antialias}
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


def _add_means(means: np.ndarray, files: Files) -> Meta:
    values = np.sign(means) * np.log1p(np.abs(means.astype(np.float64)))
    low, high = (values.min(0), values.max(0)) if len(values) else (np.zeros(3), np.zeros(3))
    words = np.rint(65535 * (values - low) / np.maximum(high - low, 1e-30)).astype(np.int64)
    files["means_l.webp"], files["means_u.webp"] = _image(_opaque(words & 255)), _image(_opaque(words >> 8))
    return {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]}


def _add_indices(name: str, values: np.ndarray, files: Files, alpha: np.ndarray | None = None) -> Meta:
    """Add the image of an attribute [N, 3], stored as indices into a codebook. `alpha` [N, 1] is its fourth channel."""
    codebook, indices = _codebook(values)
    files[f"{name}.webp"] = _image(_opaque(indices) if alpha is None else np.concatenate([indices, alpha], 1))
    return {"codebook": codebook.tolist(), "files": [f"{name}.webp"]}


def _add_palette(rest: np.ndarray, files: Files) -> Meta:
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
