"""Settings of the codecs of a reel."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

from splatreel.config.setting_values import Bits, Crf, Needs, Range, check

Rate = Literal["high", "medium", "low"]
COARSENESS: dict[Rate, float] = {"high": 0.3, "medium": 0.65, "low": 2.5}
"""Coarseness of each rate of the predictive codec, best first. The rate low has about half of the bytes of medium."""
Codec = Literal["predictive", "h265"]
Source = Literal["ofs", "ori", "dif", "raw"]


PREDICTIVE = Needs("encode.codec", ("predictive",))
QUANTIZED = Needs("encode.h265.crf_attributes", (None,))
FILMED = Needs("encode.h265.source", ("ofs", "ori", "dif"))


@dataclass(frozen=True)
class H265Config:
    """Settings of the paper's codec (section 4.3, Tables 9 and 10). Bits of none store float32, as the tables' dashes do."""

    position_bits: Annotated[int, Range(4, 21)] | None = 20
    """Bits of a coordinate (QP_DRC); none stores float32 without Draco."""
    quat_bits: Bits | None = 8
    """Bits of a component of a quaternion."""
    opacity_bits: Annotated[Bits | None, QUANTIZED] = 8
    """Bits of an opacity."""
    scale_bits: Annotated[Bits | None, QUANTIZED] = 12
    """Bits of a scale."""
    log_scales: bool = True
    """Quantize base 2 logarithms of the scales; the paper quantizes the scales themselves."""
    color_bits: Annotated[Bits | None, QUANTIZED] = 8
    """Bits of a component of c_base, and of the codebook of c_rest."""
    weighted_codebook: Annotated[bool, QUANTIZED, Needs("encode.sh_entries", but=(None, 0))] = True
    """Weight points by their importance in the codebook of c_rest; in the paper all points count alike."""
    source: Source = "ofs"
    """Coded form of the motion (Table 10): ofs, offsets; ori, positions and rotations; dif, differences from frame to frame; raw,
    offsets as float32. The web player plays ofs only."""
    crf: Annotated[Crf, FILMED] = 20
    """CRF_265 of the low byte of dx, and of dq: the quality of their video. Lower is better and larger."""
    crf_rotation: Annotated[Crf | None, FILMED] = None
    """CRF_265 of dq, if it is another one."""
    crf_attributes: Crf | None = None
    """CRF of a video of scales, opacities and colors with 8 bits, as in V3; none quantizes them as in the paper."""
    fold: Annotated[bool, FILMED] = True
    """Mirror the low byte where the high byte is odd, so that it follows a triangle wave instead of a sawtooth."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "encode.h265.")


@dataclass(frozen=True)
class EncodeConfig:
    """Settings of the codec of a reel: the predictive codec, or the paper's codec."""

    codec: Codec = "predictive"
    """Codec: predictive, or h265 as in the paper, which has settings of its own."""
    coarseness: Annotated[float, Range(1e-3), PREDICTIVE, Needs("encode.renditions", ((),))] = 0.65
    """Factor on all quantization steps of the predictive codec. A reconstruction chooses its steps for the default. Higher is
    smaller and worse."""
    renditions: Annotated[tuple[Rate, ...], PREDICTIVE] = ()
    """Rates of the predictive codec that every group is written in, best first, instead of a coarseness. Layers have the best one."""
    sh_entries: Annotated[
        Annotated[int, Range(0, 65536)] | None,
        Needs("encode.codec", ("h265",), always=(0,)),
        Needs("encode.h265.crf_attributes", (None,), always=(0,)),
        Needs("keyframe.sh_degree", but=(0,)),
    ] = 1024
    """Size of the codebook of view-dependent color in the h265 codec; none codes each point's own. 0 drops this color in both
    codecs."""
    h265: Annotated[H265Config, Needs("encode.codec", ("h265",))] = field(default_factory=H265Config)
    """Settings of the paper's codec."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "encode.")

    def with_h265(self, **values: Any) -> EncodeConfig:
        """Return the settings with other values of the paper's codec."""
        return replace(self, h265=replace(self.h265, **values))

    def rendition(self, rate: Rate) -> EncodeConfig:
        """Return the settings that one of the renditions is encoded with."""
        return replace(self, coarseness=COARSENESS[rate], renditions=())
