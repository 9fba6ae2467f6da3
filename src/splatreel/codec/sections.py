"""Gaussians as the sections of a file (paper section 4.3): quantised attributes, SH codebook, Draco positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.codec import points, quantize, vector
from splatreel.codec.quantize import Parameters, integer
from splatreel.config import EncodeConfig
from splatreel.errors import ReelError
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians

MAX_POINTS = 1 << 23


@dataclass(frozen=True)
class Section:
    """One named part of a file: its bytes, and what the header says about how to decode them."""

    data: bytes
    parameters: Parameters


Sections = dict[str, Section]


def encode_gaussians(
    gaussians: Gaussians, config: EncodeConfig, log_scales: bool = True
) -> tuple[Sections, np.ndarray]:
    """Sections of the points, and order [N]: order[i] is the input point that is decoded as point i.

    `log_scales` quantises log2 of the scales; False is the paper's linear scale. No point, no section.
    Raises `GaussiansError` for NaN and infinity.
    """
    gaussians.check_finite("Gaussians to encode")
    if len(gaussians) > MAX_POINTS:
        raise ReelError(f"{len(gaussians)} points are more than a file holds ({MAX_POINTS}).")
    if not len(gaussians):
        return {}, np.zeros(0, np.int64)
    data, parameters, order = points.encode_points(gaussians.means, config.position_bits)
    sections = {"means": Section(data, parameters)}
    ordered = gaussians[order]
    quats = rotations.normalize(ordered.quats)
    quats = np.where(quats[:, :1] < 0, -quats, quats)
    linear = {
        "quats": (quats, config.quat_bits, False),
        "scales": (ordered.scales, config.scale_bits, log_scales),
        "opacities": (ordered.opacities[:, None], config.opacity_bits, False),
        "sh_base": (ordered.sh[:, 0], config.color_bits, False),
    }
    for name, (values, bits, log) in linear.items():
        sections[name] = Section(*quantize.encode_linear(values, bits, log))
    if ordered.sh_degree and config.sh_entries:
        sections |= _encode_rest(ordered, config)
    return sections, order


def decode_gaussians(sections: Sections, count: int) -> Gaussians:
    """The `count` points of a file's sections, in reel order. Raises `ReelError` that names the section."""
    if not 0 <= count <= MAX_POINTS:
        raise ReelError(f"claims {count} points, more than the {MAX_POINTS} a file may hold.")
    if not count:
        return Gaussians.empty(0)
    means_section = section_of(sections, "means", "draco")
    means = named("means", points.decode_points, means_section.data, means_section.parameters, count)
    quats = rotations.normalize(_linear(sections, "quats", count, 4))
    scales = _linear(sections, "scales", count, 3)
    opacities = _linear(sections, "opacities", count, 1)[:, 0]
    sh = _linear(sections, "sh_base", count, 3)[:, None]
    if "sh_rest" in sections:
        sh = np.concatenate([sh, _decode_rest(sections, count)], 1)
    if (scales < 0).any() or (opacities < 0).any() or (opacities > 1).any():
        raise ReelError("has scales below 0 or opacities outside 0..1.")
    return Gaussians(means, quats, scales, opacities, sh)


def _encode_rest(gaussians: Gaussians, config: EncodeConfig) -> Sections:
    """`sh_rest` and `sh_codebook`; few points get few entries, so that the codebook does not outweigh the indices."""
    rest = gaussians.sh[:, 1:].reshape(len(gaussians), -1)
    entries = min(config.sh_entries, max(1, len(gaussians) // 4))
    codebook = vector.kmeans(rest, entries)
    nearest, _ = vector.assign(rest, codebook)
    bits = max(1, (len(codebook) - 1).bit_length())
    data, packed = quantize.deflate(quantize.pack(nearest, bits))
    indices = Section(data, {"codec": "vq", "entries": len(codebook), "bits": bits, "deflate": packed})
    data, parameters = quantize.encode_linear(codebook, config.color_bits)
    parameters |= {"entries": len(codebook), "degree": gaussians.sh_degree}
    return {"sh_rest": indices, "sh_codebook": Section(data, parameters)}


def _decode_rest(sections: Sections, count: int) -> np.ndarray:
    """c_rest, [N, (degree + 1)^2 - 1, 3]."""
    rest, codebook = section_of(sections, "sh_rest", "vq"), section_of(sections, "sh_codebook", "linear")
    entries = named("sh_rest", integer, rest.parameters, "entries", 1, 65536)
    degree = named("sh_codebook", integer, codebook.parameters, "degree", 1, 3)
    if codebook.parameters.get("entries") != entries:
        raise ReelError(
            f"section 'sh_codebook' has {codebook.parameters.get('entries')!r} entries and 'sh_rest' {entries}."
        )
    bits = named("sh_rest", integer, rest.parameters, "bits", 1, 16)
    size = quantize.packed_size(count, bits)
    plain = named("sh_rest", quantize.inflate, rest.data, rest.parameters, size)
    indices = named("sh_rest", quantize.unpack, plain, bits, count)
    if (indices >= entries).any():
        raise ReelError(f"section 'sh_rest' names entry {indices.max()} of a codebook of {entries}.")
    values = _linear(sections, "sh_codebook", entries, 3 * ((degree + 1) ** 2 - 1))
    return values[indices].reshape(count, -1, 3)


def section_of(sections: Sections, name: str, codec: str) -> Section:
    if name not in sections:
        raise ReelError(f"has no section {name!r}.")
    found = sections[name].parameters.get("codec")
    if found != codec:
        raise ReelError(f"section {name!r} has the unknown codec {found!r}, expected {codec!r}.")
    return sections[name]


def _linear(sections: Sections, name: str, rows: int, columns: int) -> np.ndarray:
    section = section_of(sections, name, "linear")
    return named(name, quantize.decode_linear, section.data, section.parameters, rows, columns)


def named(name, function, *arguments):
    """Call function; a `ReelError` of it gets the section's name."""
    try:
        return function(*arguments)
    except ReelError as error:
        raise ReelError(f"section {name!r} {error}") from error
