"""What a run learns of its cameras, and hands from group to group: colour gains, exposures, delays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from splatreel.config import Config
from splatreel.motion.exposure import even_out, exposures
from splatreel.progress import Progress
from splatreel.recon import checkpoint
from splatreel.recon.colors import CameraGains
from splatreel.recon.delays import Delays

EXPOSURE, DELAYS = "exposure.safetensors", "delays.safetensors"
"""Checkpoints in a group's folder. Gains are with its keyframe, which they were learned with."""
CHANGED = 0.02
"""Share by which an exposure changes, from which on a user hears of it."""
OUT_OF_STEP = 0.1
"""Frames that a camera is late, from which on a user hears of it."""


class Rig:
    """The training cameras, by name. exposure: [C, 3] logarithm of that at the next keyframe, against the first of the capture."""

    def __init__(self, names: list[str], config: Config, device: torch.device) -> None:
        self.names, self.even = names, config.even_exposure
        self.gains = CameraGains(len(names), device, config.correct_colors)
        self.exposure = np.zeros((len(names), 3), np.float32)
        self.delays = Delays(len(names), config.group.delays)

    def even_out(self, frames: np.ndarray, own: int, folder: Path, progress: Progress) -> None:
        """Take out of a group's frames [T, C, H, W, 3] uint8, in place, what exposures did since the first one of the capture.

        own: how many of them are not the next group's, too. folder: of the group.
        """
        if not self.even:
            return
        change = exposures(frames) + self.exposure
        even_out(frames, change)
        most = np.abs(change).max((0, 2))
        if most.max() > CHANGED:
            name = self.names[int(most.argmax())]
            progress.note(f"exposures change by up to {most.max():.0%} ({name}): taken out of the pictures")
        checkpoint.save_arrays(folder / EXPOSURE, {"change": change})
        self._expose(change, own)

    def keep_delays(self, folder: Path, progress: Progress) -> None:
        """After a group's training: its delays are where the next one starts."""
        if not self.delays.enabled:
            return
        checkpoint.save_arrays(folder / DELAYS, {"delays": self.delays.values})
        worst = int(np.abs(self.delays.values).argmax())
        late = float(self.delays.values[worst])
        if abs(late) > OUT_OF_STEP:
            how = "late" if late > 0 else "early"
            progress.note(f"cameras are out of step, {self.names[worst]} is {abs(late):.2f} frames {how}: allowed for")

    def restore(self, own: int, folder: Path) -> None:
        """Know what was known after a finished group."""
        if (keyframe := folder / "keyframe.safetensors").exists():
            self.load_gains(checkpoint.load_arrays(keyframe))
        if (exposure := folder / EXPOSURE).exists():
            self._expose(checkpoint.load_arrays(exposure)["change"], own)
        if (delays := folder / DELAYS).exists():
            self.delays.load(checkpoint.load_arrays(delays)["delays"])

    def packed_gains(self) -> dict[str, np.ndarray]:
        return {"gains": self.gains.values.cpu().numpy()}

    def load_gains(self, arrays: dict[str, np.ndarray]) -> None:
        self.gains.load(torch.from_numpy(arrays["gains"]).to(self.gains.values.device))

    def _expose(self, change: np.ndarray, own: int) -> None:
        self.exposure = change[min(own, len(change) - 1)]  # the next keyframe, if the groups overlap
