"""Encoding and decoding of layer and group files."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.codec import quantize
from splatreel.codec.container import (
    MAX_POINTS,
    FileHeader,
    Section,
    Sections,
    named,
    pack_file,
    section_of,
    unpack_file,
)
from splatreel.codec.paper import offsets as paper_offsets
from splatreel.codec.paper.gaussians import decode_gaussians, encode_gaussians
from splatreel.codec.predictive.lod_prediction import Predictor
from splatreel.codec.predictive.points import (
    decode_offsets,
    decode_points,
    decode_shade,
    encode_offsets,
    encode_points,
    encode_shade,
    read_precision,
)
from splatreel.codec.predictive.precision import COLOR, STEPS, Precision, Steps, choose_precision
from splatreel.codec.quantize import check_offset_count, check_offsets
from splatreel.config import EncodeConfig
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

_BITS = 12
"""Bits of the logarithms. If the light halves, a step is a thirtieth of a gray level."""
MOST = 1024.0
"""Maximum factor by which the light may brighten or darken."""


def _encode_light(light: np.ndarray) -> Sections:
    """Encode the factors `Group.light`, [T, 3]."""
    return {"light": Section(*quantize.encode_linear(np.clip(light, 1 / MOST, MOST), _BITS, log=True))}


def _decode_light(sections: Sections, frames: int) -> np.ndarray:
    """Decode the factors, [T, 3] float32. Raise `ReelError` if the section is damaged."""
    section = section_of(sections, "light", "linear")
    light = named("light", quantize.decode_linear, section.data, section.parameters, frames, 3)
    if not ((light > 0.99 / MOST) & (light < 1.01 * MOST)).all():
        raise ReelError(
            f"section 'light' has factors from {light.min():.3g} to {light.max():.3g}, not within {MOST:g} of 1."
        )
    return light


_MAX_STATIC = 1 << 26
"""Maximum number of static points in all layers together."""


def encode_layer(
    group: int,
    first_frame: int,
    gaussians: Gaussians,
    config: EncodeConfig,
    importance: np.ndarray | None = None,
    steps: Steps = STEPS,
) -> tuple[bytes, np.ndarray]:
    """Encode the static points born at a group.

    Args:
        group: Number of the group.
        first_frame: First frame of the group.
        gaussians: Static points.
        config: Encoding settings.
        importance: Importance of shape, color and motion, [N, 3], see `precision.classes_of`. The paper's codec uses
            only the color.
        steps: Quantization steps of the predictive codec at a coarseness of 1.

    Returns:
        The file, and order [N]: the index of the input point of each point of the file.
    """
    if config.codec == "predictive" and len(gaussians):
        precision = choose_precision(gaussians.scales, importance, config.coarseness, False, steps)
        return encode_layer_again(group, first_frame, gaussians, precision, config.sh_entries != 0)
    sections, order = encode_gaussians(gaussians, config, weights=_colors(importance))
    return pack_file(FileHeader("layer", group, len(gaussians), first_frame), sections), order


def encode_layer_again(
    group: int, first_frame: int, gaussians: Gaussians, precision: Precision, directional: bool = True
) -> tuple[bytes, np.ndarray]:
    """Encode static points, N >= 1, with a given precision. Arguments and results are those of `encode_layer`.

    `directional` False leaves out view-dependent color.
    """
    points = encode_points(gaussians, precision, directional)
    return pack_file(FileHeader("layer", group, len(gaussians), first_frame), points.sections), points.order


def encode_group(
    group: Group, config: EncodeConfig, importance: np.ndarray | None = None, steps: Steps = STEPS
) -> tuple[bytes, np.ndarray]:
    """Encode a group.

    Args:
        group: Group to encode.
        config: Encoding settings.
        importance: See `encode_layer`.
        steps: See `encode_layer`.

    Returns:
        The file, and order [N]: the index of the input point of each dynamic point of the file.
    """
    if config.codec == "predictive" and len(group.dynamic):
        precision = choose_precision(group.dynamic.scales, importance, config.coarseness, True, steps)
        return encode_group_again(group, precision, config.sh_entries != 0)
    sections, order = encode_gaussians(group.dynamic, config, config.h265.source != "ori", _colors(importance))
    if len(order):
        moving = group.dx[:, order], group.dq[:, order], group.dynamic[order]
        sections["offsets"] = Section(*paper_offsets.encode(*moving, config.h265))
    if group.shade is not None and len(order):
        predictor = Predictor.in_file_order(len(order))
        sections |= encode_shade(group.shade, order, predictor, steps.shade * config.coarseness)
    return _pack_group(group, sections, order)


def encode_group_again(group: Group, precision: Precision | None, directional: bool = True) -> tuple[bytes, np.ndarray]:
    """Encode a group with the predictive codec and a given precision, which a group without dynamic points does not need.

    Arguments and results are those of `encode_layer_again`.
    """
    sections, order = dict[str, Section](), np.zeros(0, np.int64)
    if len(group.dynamic) and precision is not None:
        points = encode_points(group.dynamic, precision, directional)
        check_offsets(group.dx, group.dq)
        sections, order = points.sections | encode_offsets(group.dx, group.dq, points), points.order
        if group.shade is not None:
            step, known = precision.steps["shade"], points.precision.bases.get("shade")
            sections |= encode_shade(group.shade, order, points.predictor, step, known)
    return _pack_group(group, sections, order)


def _pack_group(group: Group, sections: Sections, order: np.ndarray) -> tuple[bytes, np.ndarray]:
    if group.light is not None:
        sections |= _encode_light(group.light)
    if len(group.alive):
        sections["alive"] = Section(*quantize.encode_bits(group.alive))
    header = FileHeader("group", group.index, len(order), group.first_frame, group.frames)
    return pack_file(header, sections), order


def _colors(importance: np.ndarray | None) -> np.ndarray | None:
    return None if importance is None else importance[:, COLOR]


def decode_layer(data: bytes, source: str, most: int | None = None) -> tuple[FileHeader, Gaussians]:
    """Decode a layer file.

    `most`: Memory limit, see `unpack_file`.

    Raises:
        ReelError: The file is damaged. The message names the file and the section.
    """
    header, points, _, _ = _decode_layer(data, source, most)
    return header, points


def decode_parts(files: Sequence[bytes], source: str) -> Gaussians:
    """Decode the points of a layer from the files of its parts. Errors are those of `decode_layer`."""
    return Gaussians.concatenate([decode_layer(data, source)[1] for data in files])


def decode_layer_to_edit(data: bytes, source: str, most: int | None = None) -> tuple[Gaussians, Precision | None]:
    """Decode the points of a layer file and their precision, which is None in the paper's coding."""
    _, points, sections, predictor = _decode_layer(data, source, most)
    return points, None if predictor is None else read_precision(sections, 0, predictor)


def _decode_layer(
    data: bytes, source: str, most: int | None
) -> tuple[FileHeader, Gaussians, Sections, Predictor | None]:
    try:
        header, sections = unpack_file(data, most)
        if header.kind != "layer":
            raise ReelError(f"is a {header.kind} file, expected a layer.")
        points, predictor = _decode_points(sections, header.points)
        return header, points, sections, predictor
    except ReelError as error:
        raise ReelError(f"{source}: {error}") from error


def decode_group(data: bytes, source: str, most: int | None = None) -> Group:
    """Decode a group file. Arguments and errors are those of `decode_layer`."""
    return _decode_group(data, source, most)[0]


def decode_group_to_edit(data: bytes, source: str, most: int | None = None) -> tuple[Group, Precision | None]:
    """Decode a group file and the precision of its points, which is None in the paper's coding and without points."""
    group, sections, predictor = _decode_group(data, source, most)
    return group, None if predictor is None else read_precision(sections, group.frames, predictor)


def _decode_group(data: bytes, source: str, most: int | None) -> tuple[Group, Sections, Predictor | None]:
    try:
        header, sections = unpack_file(data, most)
        if header.kind != "group":
            raise ReelError(f"is a {header.kind} file, expected a group.")
        dynamic, dx, dq, predictor = _decode_moving(sections, header)
        shade = None
        if "shade" in sections and header.points:
            of_shade = predictor or Predictor.in_file_order(header.points)
            shade = decode_shade(sections, header.frames, of_shade)
        light = _decode_light(sections, header.frames) if "light" in sections else None
        alive = np.zeros(0, bool)
        if "alive" in sections:
            alive = _decode_alive(sections["alive"])
        group = Group(header.index, header.first_frame, dynamic, dx, dq, alive, shade, light)
        return group, sections, predictor
    except ReelError as error:
        raise ReelError(f"{source}: {error}") from error


def _decode_points(sections: Sections, count: int) -> tuple[Gaussians, Predictor | None]:
    """Decode points with the codec that the section `means` names, with the predictor of their offsets if the codec is predictive."""
    if "means" not in sections or sections["means"].parameters.get("codec") != "lattice":
        return decode_gaussians(sections, count), None
    if not 1 <= count <= MAX_POINTS:
        raise ReelError(f"claims {count} points, a file holds 1 to {MAX_POINTS}.")
    return decode_points(sections, count)


Moving = tuple[Gaussians, np.ndarray, np.ndarray, Predictor | None]


def _decode_moving(sections: Sections, header: FileHeader) -> Moving:
    """Return dynamic points, offsets dx [T, N, 3] and dq [T, N, 4], and the predictor of further sections."""
    count, frames = header.points, header.frames
    check_offset_count(frames, count)
    if count and "offsets" in sections and sections["offsets"].parameters.get("codec") == paper_offsets.ORIGINAL:
        means, quats = _decode_offsets(sections["offsets"], frames, count)
        dynamic = decode_gaussians(sections, count, (means[0], quats[0]))
        back = rotations.conjugate(quats[0])
        return dynamic, means - means[0], rotations.multiply(back, quats), None
    dynamic, predictor = _decode_points(sections, count)
    if predictor is not None:
        return dynamic, *decode_offsets(sections, frames, dynamic.quats, predictor), predictor
    if not count:
        return dynamic, np.zeros((frames, 0, 3), np.float32), np.zeros((frames, 0, 4), np.float32), None
    if "offsets" not in sections:
        raise ReelError("has no section 'offsets'.")
    return dynamic, *_decode_offsets(sections["offsets"], frames, count), None


def _decode_offsets(section: Section, frames: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    try:
        return paper_offsets.decode(section.data, section.parameters, frames, count)
    except ReelError as error:
        raise ReelError(f"section 'offsets' {error}") from error


def _decode_alive(section: Section) -> np.ndarray:
    try:
        if section.parameters.get("codec") != "bits":
            raise ReelError(f"has the unknown codec {section.parameters.get('codec')!r}, expected 'bits'.")
        return quantize.decode_bits(section.data, section.parameters, _MAX_STATIC)
    except ReelError as error:
        raise ReelError(f"section 'alive' {error}") from error
