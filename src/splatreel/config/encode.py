"""Settings of the reel's codecs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

from splatreel.config.values import Bits, Crf, Range, check

Rate = Literal["high", "medium", "low"]
COARSENESS: dict[Rate, float] = {"high": 0.3, "medium": 0.65, "low": 2.5}
"""Of the rates of the predictive codec, best first; low has about half of the bytes of medium."""


@dataclass(frozen=True)
class H265Config:
    """The paper's codec, section 4.3 and Tables 9 and 10. Bits of `None` do not quantize at all: float32, the tables' dashes."""

    position_bits: Annotated[int, Range(4, 21)] | None = 20
    """Bits of a coordinate (QP_DRC); none is float32 without Draco."""
    quat_bits: Bits | None = 8
    """Bits of a number of a quaternion."""
    opacity_bits: Bits | None = 8
    """Bits of an opacity."""
    scale_bits: Bits | None = 12
    """Bits of a scale."""
    log_scales: bool = True
    """Quantize base 2 logarithms of the scales; the paper quantizes the scales themselves."""
    color_bits: Bits | None = 8
    """Bits of a number of c_base, and of the codebook of c_rest."""
    weighted_codebook: bool = True
    """Points whose color the images hang on count more in the codebook of c_rest; in the paper all count alike."""
    source: Literal["ofs", "ori", "dif", "raw"] = "ofs"
    """What is coded of the motion (Table 10): offsets, positions and rotations themselves, differences from frame to frame, or
    offsets as float32. The web player plays ofs only."""
    crf: Crf = 20
    """CRF_265 of the low byte of dx and of dq: the quality of their video; lower is better and larger."""
    crf_rotation: Crf | None = None
    """CRF_265 of dq, where it is another."""
    crf_attributes: Crf | None = None
    """Code scales, opacities and colors as video of this CRF too, with 8 bits, as V3 does; none is the paper's quantization."""
    fold: bool = True
    """Store the low byte mirrored where the high byte is odd: a triangle wave instead of a sawtooth."""

    def __post_init__(self) -> None:
        check(self, "encode.h265.")


@dataclass(frozen=True)
class EncodeConfig:
    """How a reel is coded: by our predictive codec, or by the paper's."""

    codec: Literal["predictive", "h265"] = "predictive"
    """predictive is ours, h265 the paper's, which has settings of its own."""
    coarseness: Annotated[float, Range(1e-3)] = 0.65
    """Of the predictive codec: factor on all of its steps. A reconstruction chooses its steps for the default factor.
    Higher is smaller and worse."""
    renditions: tuple[Rate, ...] = ()
    """Of the predictive codec: rates that every group is written in, best first, in place of a coarseness. Layers are the best's."""
    sh_entries: Annotated[int, Range(0, 65536)] | None = 1024
    """Size of the codebook of view-dependent color in the h265 codec; none codes that of each point. 0 drops it in both codecs."""
    h265: H265Config = field(default_factory=H265Config)

    def __post_init__(self) -> None:
        check(self, "encode.")

    def with_h265(self, **values: Any) -> EncodeConfig:
        """With other values of some settings of the paper's codec."""
        return replace(self, h265=replace(self.h265, **values))

    def rendition(self, rate: Rate) -> EncodeConfig:
        """How one of the renditions is encoded."""
        return replace(self, coarseness=COARSENESS[rate], renditions=())
