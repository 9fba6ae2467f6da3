"""All settings of a reconstruction. `Config()` is what `--quality standard` uses; draft and paper are differences from it."""

from splatreel.config.config import (
    COARSENESS,
    Codec,
    Config,
    Deformation,
    EncodeConfig,
    GroupConfig,
    H265Config,
    KeyframeConfig,
    LayeringConfig,
    Rate,
    Source,
)
from splatreel.config.presets import Quality, preset

__all__ = [
    "COARSENESS",
    "Codec",
    "Config",
    "Deformation",
    "EncodeConfig",
    "GroupConfig",
    "H265Config",
    "KeyframeConfig",
    "LayeringConfig",
    "Quality",
    "Rate",
    "Source",
    "preset",
]
