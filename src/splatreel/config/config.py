"""All settings of a reconstruction."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from typing import Annotated

from splatreel.config.encode import EncodeConfig
from splatreel.config.group import GroupConfig
from splatreel.config.keyframe import KeyframeConfig
from splatreel.config.layering import LayeringConfig
from splatreel.config.setting_values import Range, check


@dataclass(frozen=True)
class Config:
    """All settings that decide the result of a reconstruction.

    The defaults are `--quality standard`. The settings are saved beside the checkpoints, so that a run is continued only with the
    same ones.

    Raises:
        UsageError: A value is out of range.
    """

    layering: LayeringConfig = field(default_factory=LayeringConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    group: GroupConfig = field(default_factory=GroupConfig)
    encode: EncodeConfig = field(default_factory=EncodeConfig)
    correct_colors: bool = True
    """Learn a color gain for each training camera, with a mean of one. Cameras that were never seen need none."""
    check_poses: bool = True
    """Correct the poses of cameras that were moved after their calibration, and leave out cameras that show something else."""
    check_coverage: bool = True
    """Predict the quality of novel views by a quick trial without one camera, before training. The reel limits its views if the
    trial fails."""
    even_exposure: bool = True
    """Remove changes of the cameras' exposures and of the scene's light from the images. The light is restored when the reel is
    played."""
    antialias: bool = True
    """Draw splats thinner than a pixel fainter (Mip-Splatting), so that the scene looks the same at any image size."""
    background: bool = True
    """Fill places that no camera has seen with the color of the images' borders instead of black."""
    training_megapixels: Annotated[float, Range(0)] = 0.7
    """Mean megapixels per training iteration. Larger images train mostly on downscaled copies, since neighboring pixels tell nearly
    the same. 0 trains at full size, except for the coarse share."""
    chapter_frames: Annotated[int, Range(0)] = 300
    """Frames of a chapter. A video longer than one and a half chapters gets static points that all chapters share; its chapters
    then train independently, on several machines if there are any. 0 makes one chapter."""
    region: str = ""
    """Volume to make a reel of, as `splatreel edit` takes it: box:x,y,z,X,Y,Z, sphere:x,y,z,RADIUS, cylinder:x,y,z,RADIUS,HEIGHT or
    capture. Its surroundings are trained coarsely and left out of the reel. Empty for everything."""
    seed: Annotated[int, Range(0)] = 0
    """Seed of all random numbers."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "")

    def for_video(self, frames: int) -> Config:
        """Return the settings for a video of a number of frames, see `KeyframeConfig.for_video`."""
        return dataclasses.replace(self, keyframe=self.keyframe.for_video(frames))

    def to_json(self) -> str:
        """Return the settings as JSON."""
        return json.dumps(dataclasses.asdict(self), indent=1, sort_keys=True)
