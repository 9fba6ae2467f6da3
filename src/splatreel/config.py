"""Every hyper-parameter of reconstruction: the paper's Table 11 and section 5.1, and the presets of `--quality`.

A `Config` is plain data. It is written next to the checkpoints, so that a run continued by the same command can tell that it is
the same run, and every ablation is one field changed with `dataclasses.replace`.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Literal

from splatreel.errors import UsageError

Quality = Literal["draft", "standard", "paper"]
Rate = Literal["high", "medium", "low"]
COARSENESS: dict[Rate, float] = {"high": 0.3, "medium": 0.65, "low": 2.5}
"""Of the rates of the predictive codec, best first; low has about half of the bytes of medium."""


@dataclass(frozen=True)
class LayeringConfig:
    """Motion layering, paper section 4.1."""

    flow: Literal["dis", "raft"] = "dis"
    segment: Literal["grabcut", "sam2", "none"] = "none"
    flow_threshold: float = 2.0
    """lambda_raft: flow longer than this many pixels, at a width of 1352, is motion."""
    flow_frames: int = 7
    """Frames of the group that flow is computed to; the paper uses 1, the next keyframe."""
    photometric_threshold: float = 6 / 255
    """Flow counts only where the two frames also differ by this much: flow on flat walls is noise."""
    lift: Literal["optimise", "vote"] = "vote"
    lift_iterations: int = 400
    lambda_nn: float = 0.5
    lambda_dyn: float = 0.3
    label_threshold: float = 0.5
    neighbours: int = 8
    adapt_every: int = 100
    """Iterations between adaptive static-point conversions; 0 turns it off."""
    adapt_gradient: float = 3e-4
    """lambda_adp^grad, normalised device units, at a width of 1352: the splats of smaller images are larger and pull harder."""
    adapt_neighbours: float = 0.6
    """lambda_adp^nn: the share of dynamic neighbours that makes a static point dynamic."""
    adapt_changes: float = 0.0
    """Only static points are converted that show this share of what they show where the pictures of the group change; goes past
    the paper."""
    light: bool = False
    """What rests while its light changes belongs to the group too, so that its colours can follow; goes past the paper."""


@dataclass(frozen=True)
class KeyframeConfig:
    """Static reconstruction of a keyframe: 3DGS, paper section 5.1."""

    first_iterations: int = 20_000
    refine_iterations: int = 5_000
    coarse_share: float = 0.0
    """Share of the iterations of the first keyframe trained at half size."""
    steady: bool = False
    """Average the keyframe's pictures over its group where nothing moves: less noise to learn by heart; goes past the paper."""
    pace: float = 1.0
    """Learning rates in multiples of those of 3DGS, which are for 30,000 iterations; the higher SH bands keep theirs."""
    reach: float = 1.0
    """Points farther than the typical viewing distance move in larger steps, up to this many times; goes past the paper."""
    sh_degree: int = 3
    max_points: int = 1_000_000
    points_per_pixel: float = 2.0
    """Never more points than this many for each pixel of one image: small images cannot tell more apart."""
    cull_opacity: float = 0.05
    lambda_opacity: float = 0.0
    """Weight of the points' opacities once densification is over, summed and divided by the pixels of an image: what explains little
    fades, floaters first; goes past the paper."""
    lambda_spread: float = 0.0
    """Weight of what lies before the surface that a pixel shows, by its distance in log depth: floaters fade; goes past the paper."""
    lambda_rough: float = 0.0
    """Weight of bends in depth where a picture is plain: with few cameras, nothing else says how far a wall is; goes past the paper."""
    densify_gradient: float = 2e-4
    densify_every: int = 100
    average_share: float = 0.0
    """Share of the iterations, the last ones, whose mean is kept in place of where the last one ended; goes past the paper."""


@dataclass(frozen=True)
class GroupConfig:
    """Group reconstruction, paper section 4.2."""

    length: int = 30
    overlap: int = 5
    deformation: Literal["trajectory", "hashgrid"] = "trajectory"
    iterations_per_frame: int = 400
    coarse_share: float = 0.0
    """Share of the iterations trained at half size; goes past the paper."""
    lambda_dssim: float = 0.2
    lambda_arap: float = 0.01
    lambda_temporal: float = 0.01
    temporal_window: int = 2
    track: bool = False
    """Start from tracks by optical flow, and from new points where several views lack something; goes past the paper."""
    shade: bool = False
    """Colour and opacity of dynamic points change slowly within a group; goes past the paper."""
    delays: bool = False
    """When each camera takes its pictures is learned: rigs are seldom quite in step; goes past the paper."""
    faint_share: float = 0.0
    """Twice on the way, the faintest points go that together hold this share of all blending weight; 0 keeps all, as the paper."""
    lambda_sh: float = 0.0
    """Weight of the sizes of the points' higher SH bands, summed and divided by the pixels of an image: what moves is seen by every
    camera in another pose, and how its colour depends on the view is mostly noise; goes past the paper."""
    progressive: float = 0.5
    """Share of the iterations over which frames are let in one after the other; 0 turns progressive sampling off."""


ENCODE_LIMITS = {
    "position_bits": (4, 21),
    "quat_bits": (1, 16),
    "opacity_bits": (1, 16),
    "scale_bits": (1, 16),
    "color_bits": (1, 16),
    "sh_entries": (0, 65536),
    "crf": (0, 51),
    "crf_rotation": (0, 51),
    "crf_attributes": (0, 51),
}
"""The least and the largest value of what `EncodeConfig` counts; `None` is allowed where it is said to mean something."""


@dataclass(frozen=True)
class EncodeConfig:
    """Compression, paper section 4.3 and Tables 9 and 10. Raises `UsageError` for numbers out of `ENCODE_LIMITS`.

    Bits of `None` do not quantise at all: float32, the dashes of the paper's tables.
    """

    codec: Literal["predictive", "h265"] = "predictive"
    """`predictive` is ours and looks at the two values below only; `h265` is the paper's, which the others are of."""
    coarseness: float = 0.65
    """Of the predictive codec: what all of its steps are multiplied by. 0.6 loses less than 0.05 dB on the captures measured."""
    renditions: tuple[Rate, ...] = ()
    """Of the predictive codec: rates that every group is written in, best first, in place of a coarseness. Layers are the best's."""
    position_bits: int | None = 20
    """QP_DRC; `None` is float32 without Draco."""
    quat_bits: int | None = 8
    opacity_bits: int | None = 8
    scale_bits: int | None = 12
    log_scales: bool = True
    """Quantise base 2 logarithms of the scales; the paper quantises the scales themselves."""
    color_bits: int | None = 8
    """Of c_base, and of the codebook of c_rest."""
    sh_entries: int | None = 1024
    """Size of the codebook of c_rest; 0 drops the higher SH bands, `None` quantises each point's own."""
    weigh: bool = True
    """Points whose colour the pictures hang on count more in the codebook; in the paper all count alike."""
    source: Literal["ofs", "ori", "dif", "raw"] = "ofs"
    """What is coded of the motion (Table 10): offsets, positions and rotations themselves, differences from frame to frame, or
    offsets as float32."""
    crf: int = 20
    """CRF_265 of the low byte of dx and of dq."""
    crf_rotation: int | None = None
    """CRF_265 of dq, where it is another."""
    crf_attributes: int | None = None
    """Code s, o, c_base and c_rest as pictures of this CRF too, with 8 bits, as V3 does; `None` is the paper's quantisation."""
    fold: bool = True
    """Store the low byte mirrored where the high byte is odd: a triangle wave instead of a sawtooth."""

    def __post_init__(self) -> None:
        for name, (low, high) in ENCODE_LIMITS.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise UsageError(f"{name} {value} is out of range. Choose {low} to {high}.")

    def rendition(self, rate: Rate) -> EncodeConfig:
        """How one of the renditions is encoded."""
        return replace(self, coarseness=COARSENESS[rate], renditions=())


LEAST = {
    "seed": 0,
    "keyframe.first_iterations": 1,
    "keyframe.refine_iterations": 1,
    "keyframe.densify_every": 1,
    "keyframe.pace": 1e-3,
    "keyframe.reach": 1,
    "keyframe.max_points": 1,
    "layering.lift_iterations": 1,
    "layering.adapt_every": 0,
    "group.iterations_per_frame": 1,
    "group.length": 1,
    "group.overlap": 0,
}
"""The least value of what counts or multiplies something."""


@dataclass(frozen=True)
class Config:
    """Everything that decides what a reconstruction looks like. Raises `UsageError` for counts that no run can have."""

    layering: LayeringConfig = field(default_factory=LayeringConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    group: GroupConfig = field(default_factory=GroupConfig)
    encode: EncodeConfig = field(default_factory=EncodeConfig)
    correct_colors: bool = True
    """Per-camera colour gain, learned on the training cameras around a mean of one; cameras never seen get none."""
    check_poses: bool = False
    """Cameras that were touched after their calibration are put right, and those that show something else left out."""
    check_coverage: bool = False
    """What new views are like is tried with a camera left out, before anything is trained; where they do not hold, the reel says so."""
    even_exposure: bool = False
    """What a camera's exposure does over time, and the light of the whole scene, is taken out of the pictures before anything looks at
    them. The light comes back when the reel is played."""
    antialias: bool = False
    """Splats thinner than a pixel are drawn fainter (Mip-Splatting): pictures of any size look alike. Beyond the paper."""
    background: bool = False
    """Where nothing is known is the colour of the pictures' borders, not black. Beyond the paper."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in LEAST.items():
            value = attrgetter(name)(self)
            if value < least:
                raise UsageError(f"{name} {value} is out of range. Choose {least} or more.")
        length, overlap = self.group.length, self.group.overlap
        if overlap >= length:
            raise UsageError(
                f"group.overlap {overlap} does not fit group.length {length}. Choose an overlap shorter than a group."
            )

    def to_json(self) -> str:
        return json.dumps(dataclasses.asdict(self), indent=1, sort_keys=True)


def preset(quality: Quality) -> Config:
    """The configuration of one `--quality`. Raises `UsageError` for an unknown name."""
    if quality == "paper":
        layering = LayeringConfig(flow_frames=1, lift="optimise", segment="grabcut")
        group, encode = GroupConfig(deformation="hashgrid"), EncodeConfig(codec="h265")
        return Config(layering=layering, group=group, encode=encode, correct_colors=False)
    standard = Config(
        keyframe=KeyframeConfig(
            first_iterations=2000,
            refine_iterations=400,
            coarse_share=0.5,
            steady=True,
            lambda_opacity=0.01,
            lambda_spread=1.0,
            lambda_rough=0.3,
            pace=4.0,
            reach=8.0,
            max_points=60_000,
            points_per_pixel=0.6,
            average_share=0.1,
        ),
        check_poses=True,
        check_coverage=True,
        even_exposure=True,
        antialias=True,
        background=True,
        layering=LayeringConfig(adapt_changes=0.3, light=True),
        group=GroupConfig(
            iterations_per_frame=110,
            coarse_share=0.25,
            track=True,
            shade=True,
            delays=True,
            faint_share=0.01,
            lambda_sh=0.05,
            progressive=0.0,
        ),
    )
    if quality == "standard":
        return standard
    if quality == "draft":
        keyframe = replace(standard.keyframe, first_iterations=1000, refine_iterations=250, max_points=30_000)
        return replace(standard, keyframe=keyframe, group=replace(standard.group, iterations_per_frame=15))
    raise UsageError(f"Unknown quality {quality!r}. Choose draft, standard or paper.")
