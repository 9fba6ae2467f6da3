"""All settings of a reconstruction. `Config()` is what `--quality standard` uses; draft and paper are differences from it."""

from splatreel.config.config import Config
from splatreel.config.encode import COARSENESS, Codec, EncodeConfig, H265Config, Rate, Source
from splatreel.config.group import Deformation, GroupConfig
from splatreel.config.keyframe import KeyframeConfig
from splatreel.config.layering import LayeringConfig
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
