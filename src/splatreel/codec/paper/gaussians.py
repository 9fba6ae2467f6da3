"""The paper's coding of Gaussians as sections: quantized attributes, SH codebook by k-means, Draco positions (QP_DRC).

Draco receives integers in Morton order, for which its float arithmetic is exact. Every decoder, in any language, then sorts the
same points.

Source:
    Paper, section 4.3.
"""

from __future__ import annotations

import struct
from types import ModuleType

import numpy as np

from splatreel.base.errors import MissingDependencyError, ReelError
from splatreel.codec import quantize
from splatreel.codec.container import MAX_POINTS, Section, Sections, named, required, section_of
from splatreel.codec.paper import hevc
from splatreel.codec.paper.hevc import decode_tracks, encode_tracks
from splatreel.codec.quantize import Parameters, boolean, integer, number, numbers
from splatreel.config import EncodeConfig
from splatreel.scene import morton, rotations
from splatreel.scene.gaussians import Gaussians

_SAMPLE = 24_576
_ROUNDS = 8
_CHUNK = 2048


def kmeans(vectors: np.ndarray, entries: int, seed: int = 0, weights: np.ndarray | None = None) -> np.ndarray:
    """Return a codebook [K, D] float32 of vectors [N, D], K <= entries, by Lloyd's algorithm on a sample.

    The same input and seed give the same codebook. If there are at most `entries` distinct vectors, they are the
    codebook.

    Args:
        vectors: Vectors to quantize.
        entries: Maximum size of the codebook.
        seed: Seed of the sample and of the initial entries.
        weights: Weight of each vector, [N] > 0; None weighs all equally. The effect of a point's color on the images is
            a good weight; opacity is not (docs/experiments/README.md).
    """
    vectors = np.ascontiguousarray(vectors, np.float32)
    rng = np.random.default_rng(seed)
    masses = np.ones(len(vectors)) if weights is None else np.asarray(weights, np.float64)
    if len(vectors) > _SAMPLE:
        sample = np.sort(rng.choice(len(vectors), _SAMPLE, replace=False))
        vectors, masses = vectors[sample], masses[sample]
    different, which = np.unique(vectors, axis=0, return_inverse=True)
    if len(different) <= entries:
        return different
    share = None if weights is None else np.bincount(which.ravel(), masses) / masses.sum()
    codebook = different[np.sort(rng.choice(len(different), entries, replace=False, p=share))]
    for _ in range(_ROUNDS):
        nearest, distance = assign(vectors, codebook)
        codebook = _centers(vectors, masses, nearest, distance, entries)
    return codebook


def assign(vectors: np.ndarray, codebook: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest entry [N] int64 of each vector [N, D] and its squared distance [N] float32."""
    vectors = np.ascontiguousarray(vectors, np.float32)
    norms = (codebook**2).sum(1)
    nearest = np.empty(len(vectors), np.int64)
    distance = np.empty(len(vectors), np.float32)
    for begin in range(0, len(vectors), _CHUNK):
        part = vectors[begin : begin + _CHUNK]
        score = norms - 2 * (part @ codebook.T)
        best = score.argmin(1)
        nearest[begin : begin + _CHUNK] = best
        distance[begin : begin + _CHUNK] = score[np.arange(len(part)), best] + (part**2).sum(1)
    return nearest, np.maximum(distance, 0)


def _centers(
    vectors: np.ndarray, masses: np.ndarray, nearest: np.ndarray, distance: np.ndarray, entries: int
) -> np.ndarray:
    """Return the weighted means of the clusters. An empty cluster moves to a vector with a large error."""
    mass = np.bincount(nearest, masses, entries)
    columns = [np.bincount(nearest, masses * column, entries) for column in vectors.T.astype(np.float64)]
    empty = np.flatnonzero(mass == 0)
    mass[empty] = 1
    centers = np.stack(columns, 1) / mass[:, None]
    centers[empty] = vectors[np.argsort(-distance * masses, kind="stable")[: len(empty)]]
    return centers.astype(np.float32)


_KD_TREE_LEVEL = 10
"""From level 7 Draco encodes point clouds with a kd-tree, about 10 % smaller than sequentially."""


def _import_draco() -> ModuleType:
    """Return the module DracoPy. Raise `MissingDependencyError` if it is not installed."""
    try:
        import DracoPy
    except ImportError as error:
        raise MissingDependencyError(
            "The paper's codec (h265) needs DracoPy, which is not installed. Run\n  pip install DracoPy\n"
            "For Windows on ARM there is no DracoPy to install. There, use --codec predictive, the default."
        ) from error
    return DracoPy


def encode_draco(means: np.ndarray, bits: int) -> tuple[bytes, Parameters, np.ndarray]:
    """Encode finite positions [N, 3], N >= 1.

    Returns:
        The section's bytes, its parameters, and order [N]: order[i] is the input point that is decoded as point i.
    """
    if not 4 <= bits <= morton.MAX_BITS:
        raise ReelError(f"Positions of {bits} bits cannot be encoded. Use 4 to {morton.MAX_BITS}.")
    means = np.asarray(means, np.float64)
    low = means.min(0)
    extent = float((means.max(0) - low).max()) or 1.0
    steps = (1 << bits) - 1
    q = _separate(np.rint((means - low) / extent * steps).astype(np.int64), bits)
    order = np.argsort(morton.encode(q), kind="stable")
    data = _import_draco().encode(
        q[order].astype(np.float32),  # sorted, so that the bytes do not depend on the input order
        quantization_bits=bits,
        compression_level=_KD_TREE_LEVEL,
        quantization_range=float(steps),
        quantization_origin=[0.0, 0.0, 0.0],
    )
    parameters: Parameters = {"codec": "draco", "bits": bits, "min": low.tolist(), "range": extent}
    if not np.array_equal(_decode_quantized(data, bits, len(means)), q[order]):
        raise ReelError("Draco did not give back the positions it was given. Use another version of DracoPy.")
    return data, parameters, order


def decode_draco(data: bytes, parameters: Parameters, count: int) -> np.ndarray:
    """Decode positions [count, 3] float32 in Morton order. Raise `ReelError` if the section is damaged."""
    bits = integer(parameters, "bits", 4, morton.MAX_BITS)
    low, extent = numbers(parameters, "min", 3), number(parameters, "range", 0, 1e30)
    return (low + _decode_quantized(data, bits, count) * (extent / ((1 << bits) - 1))).astype(np.float32)


def _decode_quantized(data: bytes, bits: int, count: int) -> np.ndarray:
    """Decode integers [count, 3] int64, sorted by Morton code."""
    _check_header(data, count)
    draco = _import_draco()
    try:
        positions = np.asarray(draco.decode(data).points)
    except (draco.FileTypeException, draco.EncodingFailedException, ValueError, MemoryError) as error:
        raise ReelError(f"is not a Draco point cloud ({error}).") from error
    if positions.shape != (count, 3) or positions.dtype.kind != "f":
        raise ReelError(f"decodes to positions of shape {positions.shape}, expected ({count}, 3).")
    if not ((positions >= 0) & (positions < 1 << bits) & (positions == np.floor(positions))).all():
        raise ReelError(f"decodes to positions that are not whole numbers of {bits} bits.")
    q = positions.astype(np.int64)
    return q[np.argsort(morton.encode(q), kind="stable")]


def _check_header(data: bytes, count: int) -> None:
    """Refuse anything but a plain point cloud of `count` points before the decoder allocates memory."""
    if len(data) < 15 or data[:5] != b"DRACO":
        raise ReelError("is not a Draco file.")
    kind, _, flags = struct.unpack_from("<BBH", data, 7)
    if kind != 0 or flags & 0x8000:
        raise ReelError("is not a plain Draco point cloud.")
    if len(data) < 21 or data[15] != 1 or data[16] != 1 or data[19] != 3:  # further attributes would take memory
        raise ReelError("is a Draco cloud of more than positions.")
    (points,) = struct.unpack_from("<i", data, 11)
    if points != count:
        raise ReelError(f"is a Draco cloud of {points} points, expected {count}.")


def _separate(q: np.ndarray, bits: int) -> np.ndarray:
    """Move points that share a grid cell to free neighboring cells, because Draco keeps only one of equal points.

    3DGS clones do coincide. A cell is a millionth of the scene, so the move is invisible.
    """
    top = (1 << bits) - 1
    for _ in range(64):
        codes = morton.encode(q)
        by_code = np.argsort(codes, kind="stable")
        ordered = codes[by_code]
        starts = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
        if len(starts) == len(q):
            return q
        rank = np.empty(len(q), np.int64)
        rank[by_code] = np.arange(len(q)) - np.repeat(starts, np.diff(np.r_[starts, len(q)]))
        step = morton.decode(rank)
        q = np.where(q + step <= top, q + step, np.maximum(q - step, 0))
    raise ReelError(f"{len(q)} positions do not fit into a lattice of {bits} bits. Use more position bits.")


def encode_gaussians(
    gaussians: Gaussians, config: EncodeConfig, placed: bool = True, weights: np.ndarray | None = None
) -> tuple[Sections, np.ndarray]:
    """Encode points as sections. Zero points give zero sections.

    Args:
        gaussians: Points to encode.
        config: Encoding settings.
        placed: Store `means` and `quats`; otherwise another section holds positions and rotations.
        weights: Effect of each point's color on the images, [N], for `H265Config.weighted_codebook`; None weighs all
            equally.

    Returns:
        The sections, and order [N]: order[i] is the input point that is decoded as point i.

    Raises:
        GaussiansError: A value is NaN or infinite.
    """
    gaussians.check_finite("Gaussians to encode")
    if len(gaussians) > MAX_POINTS:
        raise ReelError(f"{len(gaussians)} points are more than a file holds ({MAX_POINTS}).")
    if not len(gaussians):
        return {}, np.zeros(0, np.int64)
    how = config.h265
    sections, order = _encode_means(gaussians.means, how.position_bits if placed else None)
    ordered = gaussians[order]
    quats = rotations.normalize(ordered.quats)
    sections["quats"] = Section(*_encode_values(np.where(quats[:, :1] < 0, -quats, quats), how.quat_bits))
    if not placed:
        sections = {}
    crf, log = how.crf_attributes, how.log_scales
    sections["scales"] = Section(*_encode_values(ordered.scales, how.scale_bits, log=log, crf=crf))
    sections["opacities"] = Section(*_encode_values(ordered.opacities[:, None], how.opacity_bits, crf=crf))
    sections["sh_base"] = Section(*_encode_values(ordered.sh[:, 0], how.color_bits, crf=crf))
    if ordered.sh_degree and config.sh_entries != 0:
        sections |= _encode_rest(
            ordered, config, weights[order] if how.weighted_codebook and weights is not None else None
        )
    return sections, order


_Placed = tuple[np.ndarray, np.ndarray]
"""Positions [N, 3] and unit quaternions [N, 4] of points whose file has no sections for them."""


def decode_gaussians(sections: Sections, count: int, placed: _Placed | None = None) -> Gaussians:
    """Decode the `count` points of a file in reel order. Raise `ReelError` with the name of the damaged section."""
    if not 0 <= count <= MAX_POINTS:
        raise ReelError(f"claims {count} points, more than the {MAX_POINTS} a file may hold.")
    if not count:
        return Gaussians.empty(0)
    means = _decode_means(sections, count) if placed is None else placed[0]
    quats = rotations.normalize(_values(sections, "quats", count, 4)) if placed is None else placed[1]
    scales = _values(sections, "scales", count, 3)
    opacities = _values(sections, "opacities", count, 1)[:, 0]
    sh = _values(sections, "sh_base", count, 3)[:, None]
    if "sh_rest" in sections:
        sh = np.concatenate([sh, _decode_rest(sections, count)], 1)
    if (scales < 0).any():
        raise ReelError("section 'scales' has scales below 0.")
    if (opacities < 0).any() or (opacities > 1).any():
        raise ReelError("section 'opacities' has opacities outside 0..1.")
    return Gaussians(means, quats, scales, opacities, sh)


def _encode_means(means: np.ndarray, bits: int | None) -> tuple[Sections, np.ndarray]:
    """Encode the section `means` and return it with the order.

    Without bits, float32 positions are stored in the order of a Draco point cloud.
    """
    data, parameters, order = encode_draco(means, bits or morton.MAX_BITS)
    if bits is None:
        data, parameters = quantize.encode_float32(means[order])
    return {"means": Section(data, parameters)}, order


def _decode_means(sections: Sections, count: int) -> np.ndarray:
    section = required(sections, "means")
    if section.parameters.get("codec") == "float32":
        return named("means", quantize.decode_float32, section.data, (count, 3))
    section = section_of(sections, "means", "draco")
    return named("means", decode_draco, section.data, section.parameters, count)


def _encode_rest(gaussians: Gaussians, config: EncodeConfig, weights: np.ndarray | None) -> Sections:
    """Encode `sh_rest`, directly or as indices into `sh_codebook`. The codebook shrinks with the number of points."""
    rest = gaussians.sh[:, 1:].reshape(len(gaussians), -1)
    degree: Parameters = {"degree": gaussians.sh_degree}
    how = config.h265
    if config.sh_entries is None or how.crf_attributes is not None:
        data, parameters = _encode_values(rest, how.color_bits, crf=how.crf_attributes)
        return {"sh_rest": Section(data, parameters | degree)}
    entries = min(config.sh_entries, max(1, len(gaussians) // 4))
    if weights is not None:
        weights = weights / max(float(weights.mean()), 1e-30) + 1e-4  # points that no camera sees keep a small weight
    codebook = kmeans(rest, entries, weights=weights)
    nearest, _ = assign(rest, codebook)
    bits = max(1, (len(codebook) - 1).bit_length())
    data, packed = quantize.deflate(quantize.pack(nearest, bits))
    indices = Section(data, {"codec": "vq", "entries": len(codebook), "bits": bits, "deflate": packed})
    data, parameters = _encode_values(codebook, how.color_bits)
    return {"sh_rest": indices, "sh_codebook": Section(data, parameters | {"entries": len(codebook)} | degree)}


def _decode_rest(sections: Sections, count: int) -> np.ndarray:
    """Decode c_rest, [N, (degree + 1)^2 - 1, 3]."""
    rest = sections["sh_rest"]
    if rest.parameters.get("codec") != "vq":
        return _values(sections, "sh_rest", count, _coefficients(rest, "sh_rest")).reshape(count, -1, 3)
    codebook = required(sections, "sh_codebook")
    entries = named("sh_rest", integer, rest.parameters, "entries", 1, 65536)
    if codebook.parameters.get("entries") != entries:
        raise ReelError(
            f"section 'sh_codebook' has {codebook.parameters.get('entries')!r:.60} entries and 'sh_rest' {entries}."
        )
    bits = named("sh_rest", integer, rest.parameters, "bits", 1, 16)
    size = quantize.packed_size(count, bits)
    plain = named("sh_rest", quantize.inflate, rest.data, rest.parameters, size)
    indices = named("sh_rest", quantize.unpack, plain, bits, count)
    if (indices >= entries).any():
        raise ReelError(f"section 'sh_rest' names entry {indices.max()} of a codebook of {entries}.")
    values = _values(sections, "sh_codebook", entries, _coefficients(codebook, "sh_codebook"))
    return values[indices].reshape(count, -1, 3)


def _coefficients(section: Section, name: str) -> int:
    degree = named(name, integer, section.parameters, "degree", 1, 3)
    return 3 * ((degree + 1) ** 2 - 1)


def _values(sections: Sections, name: str, rows: int, columns: int) -> np.ndarray:
    section = required(sections, name)
    return named(name, _decode_values, section.data, section.parameters, rows, columns)


def _encode_values(
    values: np.ndarray, bits: int | None, *, log: bool = False, crf: int | None = None
) -> tuple[bytes, Parameters]:
    """Encode values [N, C].

    Args:
        values: One row per point.
        bits: Bits per value; None stores float32.
        log: Quantize logarithms of positive values.
        crf: Rate factor of H.265; None does not store the values as images.
    """
    if crf is not None:
        return _encode_images(values, log, crf)
    if bits is None:
        return quantize.encode_float32(values)
    return quantize.encode_linear(values, bits, log)


def _decode_values(data: bytes, parameters: Parameters, rows: int, columns: int) -> np.ndarray:
    """Decode values [rows, columns] float32 with the section's codec. Raise `ReelError` if the section is damaged."""
    codec = parameters.get("codec")
    if codec == "linear":
        return quantize.decode_linear(data, parameters, rows, columns)
    if codec == "float32":
        return quantize.decode_float32(data, (rows, columns))
    if codec == "picture":
        return _decode_images(data, parameters, rows, columns)
    raise ReelError(f"has the unknown codec {codec!r:.60}; known are linear, float32 and image.")


def _encode_images(values: np.ndarray, log: bool, crf: int) -> tuple[bytes, Parameters]:
    """Encode each column as an image of 8 bits, all in one HEVC track."""
    q, ranges = quantize.quantize_columns(values, 255, log)
    width, height = hevc.size_of(len(q))
    images = hevc.to_maps(q.astype(np.uint8).T[:, :, None], hevc.pixels_of(len(q), width), width, height)
    parameters: Parameters = {"codec": "picture", "width": width, "height": height}
    return encode_tracks([("values", images, f"crf={crf}")]), parameters | ranges


def _decode_images(data: bytes, parameters: Parameters, rows: int, columns: int) -> np.ndarray:
    width, height = hevc.decode_size(parameters, rows)
    low, high = numbers(parameters, "min", columns), numbers(parameters, "max", columns)
    images = decode_tracks(data, 1, columns, [(width, height)])[0]
    q = hevc.from_maps(images, hevc.pixels_of(rows, width), width)[:, :, 0].T
    values = low + q * ((high - low) / 255)
    if boolean(parameters, "log", default=False):
        values = np.exp2(np.clip(values, -126, 126))
    return np.ascontiguousarray(values, np.float32)
