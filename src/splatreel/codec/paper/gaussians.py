"""The paper's coding of Gaussians as sections: quantized attributes, SH codebook, Draco positions.

Source:
    Paper, section 4.3.
"""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.codec import quantize
from splatreel.codec.paper import draco_points, maps, vector
from splatreel.codec.paper.hevc import decode_tracks, encode_tracks
from splatreel.codec.quantize import Parameters, boolean, integer, numbers
from splatreel.codec.section import MAX_POINTS, Section, Sections, named, required, section_of
from splatreel.config import EncodeConfig
from splatreel.scene import morton, rotations
from splatreel.scene.gaussians import Gaussians


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
    sections["quats"] = Section(*encode_values(np.where(quats[:, :1] < 0, -quats, quats), how.quat_bits))
    if not placed:
        sections = {}
    crf, log = how.crf_attributes, how.log_scales
    sections["scales"] = Section(*encode_values(ordered.scales, how.scale_bits, log=log, crf=crf))
    sections["opacities"] = Section(*encode_values(ordered.opacities[:, None], how.opacity_bits, crf=crf))
    sections["sh_base"] = Section(*encode_values(ordered.sh[:, 0], how.color_bits, crf=crf))
    if ordered.sh_degree and config.sh_entries != 0:
        sections |= _encode_rest(
            ordered, config, weights[order] if how.weighted_codebook and weights is not None else None
        )
    return sections, order


Placed = tuple[np.ndarray, np.ndarray]
"""Positions [N, 3] and unit quaternions [N, 4] of points whose file has no sections for them."""


def decode_gaussians(sections: Sections, count: int, placed: Placed | None = None) -> Gaussians:
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
    data, parameters, order = draco_points.encode_draco(means, bits or morton.MAX_BITS)
    if bits is None:
        data, parameters = quantize.encode_float32(means[order])
    return {"means": Section(data, parameters)}, order


def _decode_means(sections: Sections, count: int) -> np.ndarray:
    section = required(sections, "means")
    if section.parameters.get("codec") == "float32":
        return named("means", quantize.decode_float32, section.data, (count, 3))
    section = section_of(sections, "means", "draco")
    return named("means", draco_points.decode_draco, section.data, section.parameters, count)


def _encode_rest(gaussians: Gaussians, config: EncodeConfig, weights: np.ndarray | None) -> Sections:
    """Encode `sh_rest`, directly or as indices into `sh_codebook`. The codebook shrinks with the number of points."""
    rest = gaussians.sh[:, 1:].reshape(len(gaussians), -1)
    degree: Parameters = {"degree": gaussians.sh_degree}
    how = config.h265
    if config.sh_entries is None or how.crf_attributes is not None:
        data, parameters = encode_values(rest, how.color_bits, crf=how.crf_attributes)
        return {"sh_rest": Section(data, parameters | degree)}
    entries = min(config.sh_entries, max(1, len(gaussians) // 4))
    if weights is not None:
        weights = weights / max(float(weights.mean()), 1e-30) + 1e-4  # points that no camera sees keep a small weight
    codebook = vector.kmeans(rest, entries, weights=weights)
    nearest, _ = vector.assign(rest, codebook)
    bits = max(1, (len(codebook) - 1).bit_length())
    data, packed = quantize.deflate(quantize.pack(nearest, bits))
    indices = Section(data, {"codec": "vq", "entries": len(codebook), "bits": bits, "deflate": packed})
    data, parameters = encode_values(codebook, how.color_bits)
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
    return named(name, decode_values, section.data, section.parameters, rows, columns)


def encode_values(
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


def decode_values(data: bytes, parameters: Parameters, rows: int, columns: int) -> np.ndarray:
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
    width, height = maps.size_of(len(q))
    images = maps.to_maps(q.astype(np.uint8).T[:, :, None], maps.pixels_of(len(q), width), width, height)
    parameters: Parameters = {"codec": "picture", "width": width, "height": height}
    return encode_tracks([("values", images, f"crf={crf}")]), parameters | ranges


def _decode_images(data: bytes, parameters: Parameters, rows: int, columns: int) -> np.ndarray:
    width, height = maps.decode_size(parameters, rows)
    low, high = numbers(parameters, "min", columns), numbers(parameters, "max", columns)
    images = decode_tracks(data, 1, columns, [(width, height)])[0]
    q = maps.from_maps(images, maps.pixels_of(rows, width), width)[:, :, 0].T
    values = low + q * ((high - low) / 255)
    if boolean(parameters, "log", default=False):
        values = np.exp2(np.clip(values, -126, 126))
    return np.ascontiguousarray(values, np.float32)
