"""The settings in `run.json` and `oracle.json`, also as earlier versions wrote them, so that their runs are continued."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

RENAMED = {
    "layering.adapt_neighbours": "layering.adapt_neighbors",
    "layering.adapt_changes": "layering.adapt_changed_share",
    "layering.light": "layering.relighting",
    "keyframe.steady": "keyframe.temporal_mean",
    "keyframe.pace": "keyframe.rate_scale",
    "keyframe.reach": "keyframe.far_step_scale",
    "keyframe.lambda_rough": "keyframe.lambda_roughness",
    "group.track": "group.tracks",
    "group.shade": "group.appearance",
    "group.delays": "group.time_offsets",
    "group.progressive": "group.progressive_share",
    "encode.position_bits": "encode.h265.position_bits",
    "encode.quat_bits": "encode.h265.quat_bits",
    "encode.opacity_bits": "encode.h265.opacity_bits",
    "encode.scale_bits": "encode.h265.scale_bits",
    "encode.log_scales": "encode.h265.log_scales",
    "encode.color_bits": "encode.h265.color_bits",
    "encode.weigh": "encode.h265.weighted_codebook",
    "encode.source": "encode.h265.source",
    "encode.crf": "encode.h265.crf",
    "encode.crf_rotation": "encode.h265.crf_rotation",
    "encode.crf_attributes": "encode.h265.crf_attributes",
    "encode.fold": "encode.h265.fold",
}
"""Names until 0.1.0, and what they are called now."""

RESPELLED = {"layering.lift": {"optimise": "optimize"}}
"""Values until 0.1.0, and how they are written now."""

CONSTANT: dict[str, Any] = {
    "layering.photometric_threshold": 6 / 255,
    "layering.lift_iterations": 400,
    "layering.label_threshold": 0.5,
    "layering.neighbours": 8,
    "keyframe.cull_opacity": 0.05,
    "keyframe.densify_gradient": 2e-4,
    "group.temporal_window": 2,
}
"""What could be set until 0.1.0 and has one value now."""

UNSAID: dict[str, Any] = {
    "layering.flow": "dis",
    "layering.segment": "none",
    "layering.flow_threshold": 2.0,
    "layering.flow_frames": 7,
    "layering.lift": "vote",
    "layering.lambda_nn": 0.5,
    "layering.lambda_dyn": 0.3,
    "layering.adapt_every": 100,
    "layering.adapt_gradient": 3e-4,
    "layering.adapt_neighbors": 0.6,
    "layering.adapt_changed_share": 0.0,
    "layering.relighting": False,
    "keyframe.first_iterations": 20_000,
    "keyframe.refine_iterations": 5_000,
    "keyframe.coarse_share": 0.0,
    "keyframe.temporal_mean": False,
    "keyframe.rate_scale": 1.0,
    "keyframe.far_step_scale": 1.0,
    "keyframe.sh_degree": 3,
    "keyframe.max_points": 1_000_000,
    "keyframe.points_per_pixel": 2.0,
    "keyframe.lambda_opacity": 0.0,
    "keyframe.lambda_spread": 0.0,
    "keyframe.lambda_roughness": 0.0,
    "keyframe.densify_every": 100,
    "keyframe.average_share": 0.0,
    "group.length": 30,
    "group.overlap": 5,
    "group.deformation": "trajectory",
    "group.iterations_per_frame": 400,
    "group.coarse_share": 0.0,
    "group.lambda_dssim": 0.2,
    "group.lambda_arap": 0.01,
    "group.lambda_temporal": 0.01,
    "group.tracks": False,
    "group.appearance": False,
    "group.time_offsets": False,
    "group.faint_share": 0.0,
    "group.lambda_sh": 0.0,
    "group.progressive_share": 0.5,
    "encode.codec": "predictive",
    "encode.coarseness": 0.65,
    "encode.renditions": [],
    "encode.sh_entries": 1024,
    "encode.h265.position_bits": 20,
    "encode.h265.quat_bits": 8,
    "encode.h265.opacity_bits": 8,
    "encode.h265.scale_bits": 12,
    "encode.h265.log_scales": True,
    "encode.h265.color_bits": 8,
    "encode.h265.weighted_codebook": True,
    "encode.h265.source": "ofs",
    "encode.h265.crf": 20,
    "encode.h265.crf_rotation": None,
    "encode.h265.crf_attributes": None,
    "encode.h265.fold": True,
    "correct_colors": True,
    "check_poses": False,
    "check_coverage": False,
    "even_exposure": False,
    "antialias": False,
    "background": False,
    "chapter_frames": 0,
    "seed": 0,
    "training_megapixels": 0.0,
}
"""What a record means that does not say a setting: it is of a version that did not know it, which did as if it were turned off.
A new setting comes here with the value that changes nothing."""


def updated(theirs: Any) -> dict[str, Any]:
    """The settings in a record, nested as `Config.to_json` writes them now.

    What has become a constant is left out where it had that value, and stays where it had another, which no config has.
    """
    said = _flat(theirs, "") if isinstance(theirs, dict) else {}
    said = {name: value for name, value in said.items() if name not in CONSTANT or value != CONSTANT[name]}
    said = {RENAMED.get(name, name): value for name, value in said.items()}
    for name, spellings in RESPELLED.items():
        if name in said and isinstance(said[name], str):
            said[name] = spellings.get(said[name], said[name])
    return _nested(UNSAID | said)


def _flat(record: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    flat = {}
    for name, value in record.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


def _nested(flat: Mapping[str, Any]) -> dict[str, Any]:
    nested: dict[str, Any] = {}
    for name, value in flat.items():
        *sections, last = name.split(".")
        place = nested
        for section in sections:
            place = place.setdefault(section, {})
        place[last] = value
    return nested
