"""All settings of a reconstruction. `Config()` is what `--quality standard` uses; draft and paper are differences from it."""

from splatreel.config.config import Config
from splatreel.config.encode import COARSENESS, EncodeConfig, H265Config, Rate
from splatreel.config.group import GroupConfig
from splatreel.config.keyframe import KeyframeConfig
from splatreel.config.layering import LayeringConfig
from splatreel.config.presets import Quality, preset

__all__ = [
    "COARSENESS",
    "Config",
    "EncodeConfig",
    "GroupConfig",
    "H265Config",
    "KeyframeConfig",
    "LayeringConfig",
    "Quality",
    "Rate",
    "preset",
]
