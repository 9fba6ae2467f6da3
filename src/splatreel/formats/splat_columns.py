"""Conversion of named columns, as PLY files have them, to Gaussians. Unusual columns are converted, remarked on or refused."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.command_line import install_command
from splatreel.base.errors import GaussiansError
from splatreel.base.ply_table import Columns
from splatreel.scene import rotations
from splatreel.scene.gaussians import C0, Gaussians


def name_columns(
    means: np.ndarray,
    scales: np.ndarray,
    quats: np.ndarray,
    base: np.ndarray,
    opacity: np.ndarray,
    rest: np.ndarray | None = None,
) -> Columns:
    """Return columns with the names that they have in a 3DGS PLY file.

    Args:
        means: Positions, [N, 3].
        scales: Logarithms of scales, [N, 3].
        quats: Rotations, wxyz, [N, 4].
        base: First coefficients of color, [N, 3].
        opacity: Logits, or bytes, [N].
        rest: Coefficients of view-dependent color, [N, bands, 3].
    """
    found = dict(zip("xyz", means.T, strict=True)) | {"opacity": opacity}
    for name, values in (("scale", scales), ("f_dc", base), ("rot", quats)):
        found |= {f"{name}_{i}": column for i, column in enumerate(values.T)}
    if rest is not None:
        bands = rest.shape[1]
        found |= {f"f_rest_{bands * c + i}": rest[:, i, c] for c in range(3) for i in range(bands)}
    return found


def concatenate_columns(parts: Sequence[Columns]) -> Columns:
    """Return the points of all parts. Parts with less view-dependent color than others get zeros."""
    names = max(parts, key=len, default={})
    return {name: np.concatenate([part.get(name, np.zeros(len(part["x"]))) for part in parts]) for name in names}


def logit(shares: np.ndarray) -> np.ndarray:
    """Return the logits of opacities 0..1, infinite at both ends."""
    with np.errstate(divide="ignore"):
        return np.log(shares) - np.log1p(-shares)


def import_for_splats(module: str, subject: str) -> Any:
    """Import an optional package that a format needs.

    Args:
        module: Name of the package.
        subject: File that needs the package, and what for.

    Raises:
        GaussiansError: The package is not installed. The message has the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        command = install_command("splats")
        raise GaussiansError(f"{subject} needs the package {error.name or module}. Run\n  {command}") from error


class Remarks:
    """Collection of remarks, by text and file. A file that is read twice counts once."""

    def __init__(self) -> None:
        self._counts: dict[str, dict[str, int]] = {}

    def add(self, text: str, source: str | Path, count: int = 1) -> None:
        """Add a remark.

        Args:
            text: Sentence without its full stop; `{}` is replaced by the sum of the counts.
            source: File that the remark is about.
            count: Number of points, or 1.
        """
        self._counts.setdefault(text, {})[str(source)] = count

    def lines(self) -> list[str]:
        """Return one line per remark, with the number of files and the first of them."""
        lines = []
        for text, counts in self._counts.items():
            first = next(iter(counts))
            where = first if len(counts) == 1 else f"{len(counts)} files, the first of them {first}"
            lines.append(f"{text.format(f'{sum(counts.values()):,}')} ({where}).")
        return lines

    def take(self, others: Remarks, source: str) -> None:
        """Add the remarks of another collection, all of them about one file."""
        for text, counts in others._counts.items():
            self.add(text, source, sum(counts.values()))


LIMITS = {"means": 1e12, "scales": 1e12, "sh": 1e4}
"""Maximum plausible values: world units, world units, and color coefficients, for which 1 is large."""


def check_plausible(points: Gaussians, what: str) -> Gaussians:
    """Return the Gaussians if all values are plausible.

    `what`: Start of the message.

    Raises:
        GaussiansError: A value exceeds its limit. The message names the point and the value.
    """
    if not len(points):
        return points
    for name, limit in LIMITS.items():
        values = np.abs(getattr(points, name)).reshape(len(points), -1)
        if values.max() > limit:
            row = int(values.max(1).argmax())
            raise GaussiansError(
                f"{what}: {name} of point {row} (counted from 0) is {values[row].max():.3g}, beyond the {limit:g} that a reel can "
                f"hold. Remove that point from the file, or export it again."
            )
    return points


EXPORT = "Write one PLY file per frame with that method's program, and import the folder."


@dataclass(frozen=True)
class Method:
    """A method by the names of its columns.

    Attributes:
        name: Name of the method, and its repository.
        columns: Pattern of the columns that only this method writes.
        what: Meaning of the columns.
        remedy: What to do instead.
    """

    name: str
    columns: re.Pattern[str]
    what: str = "which move or change its Gaussians"
    remedy: str = EXPORT


METHODS = (
    # scene/c_gaussian_model.py: static points here, moving ones in dynamic_point_cloud.ply
    Method("Ex4DGS (juno181/Ex4DGS)", re.compile(r"xyz_disp_\d+|motion_(xyz|f_dc|f_rest|scale|opacity|rot)(_.*)?")),
    # scene/gaussian_model.py
    Method("SplineGS (KAIST-VICLab/SplineGS)", re.compile(r"control_[xyz]_\d+|current_control_num")),
    # scene/oursfull.py, ourslite.py; MoDec-GS and others use the names too
    Method(
        "SpacetimeGaussians (oppo-us-research/SpacetimeGaussians) or a method built on it",
        re.compile(r"trbf_.*|motion_\d+|omega_\d+|f_t_\d+"),
    ),
    # scene/gaussian_model.py: features that the network of control points reads
    Method(
        "SC-GS (yihua7/SC-GS) or a method built on it", re.compile(r"fea_\d+"), "which its network turns into motion"
    ),
    # scene/gaussian_model.py: embeddings that the deformation network reads
    Method(
        "E-D3DGS (JeongminB/E-D3DGS) or a method built on it",
        re.compile(r"embedding_\d+"),
        "which its network turns into motion",
    ),
    # 4D Gaussian Splatting with its PLY writers: time, extent in time, and the second rotation
    Method(
        "4D Gaussian Splatting (fudan-zvg/4d-gaussian-splatting)",
        re.compile(r"t|mu_t|t_scale|scale_t(_\d+)?|rot_[lr]_\d+"),
    ),
    # scene/beta_model.py; deformable kernels, and lobes instead of harmonics
    Method(
        "Beta Splatting (RongLiu-Leo/beta-splatting)",
        re.compile(r"beta|sb_params_\d+|sh0_\d+|shN_\d+"),
        "whose points are Beta kernels and no Gaussians",
        "Train Gaussians, for example with gsplat.",
    ),
    # scene/gaussian_model.py: anchors, from which networks make Gaussians for each view
    Method(
        "Scaffold-GS (city-super/Scaffold-GS) or a method built on it",
        re.compile(r"f_offset_\d+|f_anchor_feat_\d+"),
        "whose points are anchors, from which networks make the Gaussians of each view",
        "Train 3DGS, or export its Gaussians with that method's program.",
    ),
)
"""Methods by their columns, the most specific first."""
_OF_TIME = re.compile(
    r"t|time.*|timestamp|t_.*|.*_t|.*_t\d+|motion.*|trbf.*|omega.*|vel.*|v[xyz]|acc.*|rot_r.*|f_t.*|deform.*|traj.*|knot.*|poly.*"
    r"|dynamic.*|duration.*|life.*|birth.*|death.*|delta_.*|d_xyz.*|fourier.*|coef.*|basis.*|spline.*|control_.*|weight_motion.*|zeta_.*"
)
"""Names of columns that make Gaussians move or change, of any method."""


def refusal_of(names: Iterable[str]) -> str | None:
    """Return why a file with some unusual columns cannot be read, and what to do; None if it can."""
    names = list(names)
    for method in METHODS:
        if found := [name for name in names if method.columns.fullmatch(name)]:
            return f"has the columns {_some(found)} of {method.name}, {method.what}. {method.remedy}"
    if found := [name for name in names if _OF_TIME.fullmatch(name)]:
        return (
            f"has the columns {_some(found)} of a method whose Gaussians move or change, which is not known here. Export one PLY file "
            "per frame with that method's program."
        )
    return None


def _some(names: list[str]) -> str:
    return f"{', '.join(names[:4])}{', ...' if names[4:] else ''}"


MANY = 16
"""Points that show whether values are activated. Fewer are judged by opacities and scales together."""
_THIN = 0.01
"""Third scale of flat splats (2DGS), as a share of the smaller one."""
_LARGEST_LOGARITHM = 80
OPAQUE = 20.0
"""Logit of an opacity that is 1 in float32. No training tells larger ones apart."""
BANDS = {0: 0, 9: 1, 24: 2, 45: 3, 72: 4}
"""SH degree by number of f_rest columns."""
COLORS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_TURNS = (("rot_0", "rot_1", "rot_2", "rot_3"), ("qw", "qx", "qy", "qz"), ("rot_w", "rot_x", "rot_y", "rot_z"))
SIZES = (
    ("scale_0", "scale_1", "scale_2"),
    ("scale_x", "scale_y", "scale_z"),
    ("scale_0", "scale_1"),
    ("scale_0",),
    ("scale",),
)
_OF_NO_EFFECT = re.compile(r"n[xyz]|alpha|.*(red|green|blue)|[rgba]")


@dataclass(frozen=True)
class Encoding:
    """Storage of opacities and scales: 3DGS stores logits and natural logarithms, some programs the values."""

    logit: bool = True
    logarithm: bool = True
    certain: bool = False
    """The format defines it, so that unusual values need no remark."""


def encoding_of(columns: Columns) -> Encoding:
    """Return how opacities and scales are stored.

    Opacities that all lie in 0..1 are not logits, which would all be half transparent. Scales that are all positive are
    not logarithms if they would all be about 1, or if the opacities are not logits.
    """
    opacity, names = columns.get("opacity"), _first_of(SIZES, columns)
    count = len(opacity) if opacity is not None else 0
    values = _finite(opacity) if opacity is not None and opacity.dtype.kind == "f" else np.zeros(0)
    scales = _finite(np.concatenate([columns[name] for name in names])) if names else np.zeros(0)
    plain = bool(len(values)) and values.min() >= 0 and 0 < values.max() <= 1
    positive = bool(len(scales)) and scales.min() >= 0 and scales.max() > 0
    constant = plain and values.min() == values.max() < 1
    if count < MANY or constant:
        both = plain and positive and np.quantile(scales, 0.99) < 1
        return Encoding(not both, not both)
    near_one = positive and bool(np.quantile(scales, 0.99) < 0.5)
    return Encoding(logit=not plain, logarithm=not (positive and (plain or near_one)))


def gaussians_of(
    columns: Columns, source: str, origin: np.ndarray | None, remarks: Remarks, encoding: Encoding | None = None
) -> Gaussians:
    """Return the Gaussians of columns. Points that hold NaN are dropped.

    Args:
        columns: Columns by name, [N] each.
        source: Name of the file, for messages.
        origin: Point subtracted from all positions before rounding to float32, [3] float64; None subtracts nothing.
        remarks: Receives what was converted or dropped.
        encoding: How opacities and scales are stored; None recognizes it.

    Raises:
        GaussiansError: A column is missing, or has a meaning that cannot be converted.
    """
    names = _first_of(SIZES, columns)
    if names is None or not all(name in columns for name in "xyz"):
        raise GaussiansError(_not_splats(columns, source))
    _check_names(columns, names, source, remarks)
    encoding = encoding or encoding_of(columns)
    scales = _scales(columns, names, encoding, source, remarks)
    opacities = _opacities(columns, encoding, source, remarks)
    if "filter_3D" in columns:
        scales, opacities = _filtered(scales, opacities, np.asarray(columns["filter_3D"], np.float64))
        remarks.add("The column filter_3D of Mip-Splatting was applied to scales and opacities", source)
    found = Gaussians(
        means=_stack(columns, "x", "y", "z") - (0.0 if origin is None else origin),
        quats=_quats(columns, names, source, remarks),
        scales=scales,
        opacities=opacities,
        sh=_harmonics(columns, source, remarks),
    )
    return drop_nan(found, source, remarks)


def drop_nan(points: Gaussians, source: str, remarks: Remarks) -> Gaussians:
    """Return the Gaussians without those that hold NaN or infinite values, and remark on their number."""
    if not len(points):
        return points
    arrays = (points.means, points.quats, points.scales, points.opacities, points.sh)
    good = np.logical_and.reduce([np.isfinite(array).reshape(len(points), -1).all(1) for array in arrays])
    if good.all():
        return points
    remarks.add("{} points with NaN or infinite values were dropped", source, int((~good).sum()))
    return points[good]


def _finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)].astype(np.float64)


def _first_of(choices: tuple[tuple[str, ...], ...], columns: Columns) -> tuple[str, ...] | None:
    """Return the first choice whose columns all exist."""
    return next((names for names in choices if all(name in columns for name in names)), None)


def _stack(columns: Columns, *names: str) -> np.ndarray:
    return np.stack([np.asarray(columns[name], np.float64) for name in names], -1)


def _not_splats(columns: Columns, source: str) -> str:
    if refusal := refusal_of(columns):
        return f"{source}: {refusal}"
    if all(name in columns for name in "xyz"):
        return (
            f"{source}: is a point cloud without sizes (no scale_0, scale_1, scale_2), not Gaussians. Name the file that the training "
            "of the Gaussians wrote, often point_cloud/iteration_N/point_cloud.ply."
        )
    missing = ", ".join(name for name in "xyz" if name not in columns)
    return f"{source}: is not a PLY of 3D Gaussians: missing {missing}."


def _check_names(columns: Columns, sizes: tuple[str, ...], source: str, remarks: Remarks) -> None:
    """Refuse columns of other methods, and remark on columns without a meaning here."""
    known = {"x", "y", "z", "opacity", "filter_3D", *sizes}
    known |= {name for names in _TURNS for name in names} | {f"f_dc_{i}" for i in range(3)}
    others = [name for name in columns if name not in known and not re.fullmatch(r"f_rest_\d+", name)]
    if refusal := refusal_of(others):
        raise GaussiansError(f"{source}: {refusal}")
    strange = [name for name in others if not _OF_NO_EFFECT.fullmatch(name)]
    if strange:
        remarks.add(
            f"Unknown columns were ignored, also if the program that wrote them draws points by them: {', '.join(strange[:6])}"
            f"{', ...' if strange[6:] else ''}",
            source,
        )


def _scales(columns: Columns, names: tuple[str, ...], encoding: Encoding, source: str, remarks: Remarks) -> np.ndarray:
    """Return activated scales [N, 3]."""
    scales = _stack(columns, *names)
    if encoding.logarithm:
        scales = np.exp(np.minimum(scales, _LARGEST_LOGARITHM))
    else:
        remarks.add("Scales are stored as they are, not as logarithms", source)
    if len(names) == 1:
        remarks.add("One scale is stored for all three axes", source)
        scales = np.repeat(scales, 3, axis=1)
    if len(names) == 2:
        remarks.add("Flat splats with two scales (2DGS) were read as thin ones", source)
        scales = np.concatenate([scales, _THIN * scales.min(1, keepdims=True)], 1)
    return scales


def _opacities(columns: Columns, encoding: Encoding, source: str, remarks: Remarks) -> np.ndarray:
    """Return activated opacities [N]."""
    name = next((name for name in ("opacity", "alpha", "a") if name in columns), None)
    if name is None:
        remarks.add("No opacity is stored: all points were read as opaque", source)
        return np.ones(len(columns["x"]))
    values = columns[name]
    if values.dtype.kind != "f":
        return values.astype(np.float64) / np.iinfo(values.dtype).max
    values = values.astype(np.float64)
    if not encoding.logit or name != "opacity":
        remarks.add("Opacities are stored as they are, not as logits", source)
        return np.clip(values, 0, 1)
    _check_logits(values, encoding, source)
    if not encoding.certain and len(values) >= MANY and 0 < values.min() == values.max() < 1:
        remarks.add(
            f"All opacities are {values[0]:.3g}, read as the logit of {1 / (1 + np.exp(-values[0])):.3g}", source
        )
    return 1 / (1 + np.exp(-np.clip(values, -_LARGEST_LOGARITHM, _LARGEST_LOGARITHM)))


def _check_logits(values: np.ndarray, encoding: Encoding, source: str) -> None:
    """Refuse opacities like percents or bytes, of which many as logits would be 1, and none below a half."""
    finite = _finite(values)
    if encoding.certain or len(finite) < MANY or finite.min() < 0:
        return
    if np.quantile(finite, 0.02) < OPAQUE < np.quantile(finite, 0.9):
        raise GaussiansError(
            f"{source}: has opacities from {finite.min():.3g} to {finite.max():.3g}, which are neither logits nor 0 to 1. Export it "
            "again with one of them."
        )


def _filtered(scales: np.ndarray, opacities: np.ndarray, width: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return scales [N, 3] and opacities [N] after the 3D smoothing filter of Mip-Splatting, width [N].

    Source:
        Mip-Splatting, section 4.1.
    """
    wide = np.sqrt(scales**2 + width[:, None] ** 2)
    return wide, opacities * np.prod(scales / np.maximum(wide, 1e-30), 1)


def _quats(columns: Columns, sizes: tuple[str, ...], source: str, remarks: Remarks) -> np.ndarray:
    """Return unit quaternions [N, 4] wxyz."""
    names = _first_of(_TURNS, columns)
    if names is not None:
        quats = _stack(columns, *names)
        if empty := int((quats == 0).all(1).sum()):
            remarks.add("{} points with a rotation of zeros were read as aligned with the axes", source, empty)
        return rotations.normalize(quats)
    partial = [name for names in _TURNS for name in names if name in columns]
    if partial:
        raise GaussiansError(f"{source}: has {', '.join(partial)} of the four numbers of a rotation. Export it again.")
    if len(sizes) > 1:
        remarks.add("No rotation is stored: all points were read as aligned with the axes", source)
    return np.tile([1.0, 0, 0, 0], (len(columns["x"]), 1))


def _harmonics(columns: Columns, source: str, remarks: Remarks) -> np.ndarray:
    """Return spherical harmonics [N, (degree + 1)^2, 3]."""
    rest = sum(re.fullmatch(r"f_rest_\d+", name) is not None for name in columns)
    if rest not in BANDS or not all(f"f_rest_{i}" in columns for i in range(rest)):
        raise GaussiansError(
            f"{source}: has {rest} f_rest columns, expected one of {', '.join(map(str, BANDS))}, without gaps."
        )
    if all(f"f_dc_{i}" in columns for i in range(3)):
        sh = _stack(columns, "f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    elif (names := _first_of(COLORS, columns)) is not None and not rest:
        remarks.add(f"Colors were read from {', '.join(names)}", source)
        return ((_unit_colors(columns, names, source) - 0.5) / C0)[:, None]
    else:
        raise GaussiansError(
            f"{source}: has no color, neither f_dc_0, f_dc_1, f_dc_2 nor red, green, blue. Export it again."
        )
    if not rest:
        return sh
    higher = _stack(columns, *(f"f_rest_{i}" for i in range(rest))).reshape(len(sh), 3, rest // 3).transpose(0, 2, 1)
    if BANDS[rest] > 3:
        remarks.add("View-dependent color of degree 4 was cut to degree 3, the highest that a reel holds", source)
        higher = higher[:, :15]
    return np.concatenate([sh, higher], 1)


def _unit_colors(columns: Columns, names: tuple[str, ...], source: str) -> np.ndarray:
    """Return colors [N, 3], 0..1, of bytes, words or floats."""
    kind, values = columns[names[0]].dtype, _stack(columns, *names)
    if kind.kind != "f":
        return values / np.iinfo(kind).max
    largest = np.nanmax(values, initial=0.0)
    if not np.nanmin(values, initial=0.0) >= 0 or largest > 255:
        raise GaussiansError(f"{source}: has colors up to {largest:.3g}, expected 0 to 1 or 0 to 255. Export it again.")
    return values / (255 if largest > 1 else 1)
