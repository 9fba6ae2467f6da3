"""Columns of PLY files that are not plain Gaussians: names, and the methods that write them.

The names are those that the methods' own code writes. The table states the repository of each.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

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
