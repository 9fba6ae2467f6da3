"""What a run learns of its cameras, and hands from group to group: poses, colour gains, exposures and the light, delays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from splatreel.config import Config
from splatreel.motion.exposure import even_out, exposures
from splatreel.progress import Progress
from splatreel.recon.cameras.color_gains import CameraGains
from splatreel.recon.cameras.findings import Findings
from splatreel.recon.cameras.poses import check_poses
from splatreel.recon.cameras.time_offsets import SURE, TimeOffsets
from splatreel.recon.run import checkpoint
from splatreel.scene.camera import Camera

POSES, EXPOSURE, DELAYS = "poses.safetensors", "exposure.safetensors", "delays.safetensors"
"""Checkpoints in a group's folder. Gains are with its keyframe, which they were learned with."""
CHANGED = 0.02
"""Share by which an exposure or the light changes, from which on a user hears of it."""
OUT_OF_STEP = 0.1
"""Frames that a camera is late, from which on a user hears of it, if the pictures tell so much."""


class Rig:
    """The training cameras as they are now.

    exposure: [C, 3] logarithms of theirs at the next keyframe, against the capture's first. light: [3] that of the light there.
    ends: [C] delays at the end of each group so far.
    """

    def __init__(self, cameras: list[Camera], config: Config, device: torch.device) -> None:
        self.cameras, self.config, self.device = list(cameras), config, device
        self._start()

    def _start(self) -> None:
        count, config = len(self.cameras), self.config
        self.gains = CameraGains(count, self.device, config.correct_colors)
        self.exposure, self.light = np.zeros((count, 3), np.float32), np.zeros(3, np.float32)
        self.delays = TimeOffsets(count, config.group.time_offsets)
        self.ends: list[np.ndarray] = []

    @property
    def names(self) -> list[str]:
        return [camera.name for camera in self.cameras]

    def gather(self, frames: np.ndarray, folder: Path, progress: Progress, origin: str = "The capture") -> np.ndarray:
        """At the start of a capture: `place`, but cameras that do not show what their neighbours do are left out.

        origin: where the poses come from. Returns the frames of those that stay. Raises `ReconstructionError` for poses that are not
        world to camera.
        """
        if not self.config.check_poses:
            return frames
        found = self._inspect(frames, progress)
        found.refuse(origin)
        for doubt in found.doubts(self.names):
            progress.note(doubt)
        kept = [number for number in range(len(self.cameras)) if number not in found.strangers]
        self._keep(kept)
        checkpoint.save_arrays(folder / POSES, self._packed() | {"kept": np.array(kept)})
        return frames[:, kept]

    def place(self, frames: np.ndarray, folder: Path, progress: Progress) -> None:
        """Put right the cameras that are not where they are said to be. frames: [T, C, H, W, 3] uint8, of a group. folder: of it."""
        if not self.config.check_poses:
            return
        if (folder / POSES).exists():
            self.stand(folder)
            return
        for number in self._inspect(frames, progress).strangers:
            progress.note(f"{self.names[number]} no longer shows what its neighbours do: check its video")
        checkpoint.save_arrays(folder / POSES, self._packed())

    def stand(self, folder: Path) -> None:
        """Where the cameras stood in a group, if that is known, and which they are."""
        if (path := folder / POSES).exists():
            arrays = checkpoint.load_arrays(path)
            if "kept" in arrays and len(arrays["kept"]) < len(self.cameras):
                self._keep(arrays["kept"].tolist())
            pairs = zip(self.cameras, arrays["viewmats"], strict=True)
            self.cameras = [replace(camera, viewmat=viewmat) for camera, viewmat in pairs]

    def _inspect(self, frames: np.ndarray, progress: Progress) -> Findings:
        """Puts right what can be, by two moments of a group."""
        found = check_poses(self.cameras, frames[[0, len(frames) // 2]])
        for repair in found.repairs(self.names):
            progress.note(repair)
        for number, mended in found.mended.items():
            self.cameras[number] = mended.camera
        return found

    def _keep(self, kept: list[int]) -> None:
        self.cameras = [self.cameras[number] for number in kept]
        self._start()

    def _packed(self) -> dict[str, np.ndarray]:
        return {"viewmats": np.stack([camera.viewmat for camera in self.cameras])}

    def even_out(self, frames: np.ndarray, own: int, folder: Path, progress: Progress) -> np.ndarray | None:
        """Take out of a group's frames [T, C, H, W, 3] uint8, in place, what exposures and the light did since the capture's first.

        own: how many of them are not the next group's, too. folder: of the group. Returns the light, `Group.light`.
        """
        if not self.config.even_exposure:
            return None
        changes = exposures(frames)
        change, light = changes[0] + self.exposure, changes[1] + self.light
        even_out(frames, change + light[:, None])
        most = np.abs(change).max((0, 2))
        if most.max() > CHANGED:
            name = self.names[int(most.argmax())]
            progress.note(f"exposures change by up to {most.max():.0%} ({name}): taken out of the pictures")
        if (most := np.abs(np.expm1(light)).max()) > CHANGED:
            progress.note(
                f"the light changes by up to {most:.0%}: taken out of the pictures, and back when they are played"
            )
        arrays = {"change": change, "light": light}
        checkpoint.save_arrays(folder / EXPOSURE, arrays)
        self._expose(arrays, own)
        return np.exp(light) if light.any() else None

    def keep_delays(self, folder: Path, progress: Progress) -> None:
        """After a group's training: its delays are where the next one starts."""
        if not self.delays.enabled:
            return
        checkpoint.save_arrays(folder / DELAYS, {"delays": self.delays.values})
        self.ends.append(self.delays.values.copy())
        late, off = np.abs(self.delays.values), self.delays.uncertainty(self.ends)
        told = late > np.maximum(SURE * off, OUT_OF_STEP)
        if told.any():
            worst = int(np.where(told, late, 0).argmax())
            how = "late" if self.delays.values[worst] > 0 else "early"
            much = f"{late[worst]:.2f} frames {how} (give or take {off[worst]:.2f})"
            progress.note(f"cameras are out of step, {self.names[worst]} is {much}: allowed for")

    def restore(self, own: int, folder: Path) -> None:
        """Know what was known after a finished group."""
        self.stand(folder)
        if (keyframe := folder / "keyframe.safetensors").exists():
            self.load_gains(checkpoint.load_arrays(keyframe))
        if (exposure := folder / EXPOSURE).exists():
            self._expose(checkpoint.load_arrays(exposure), own)
        if (delays := folder / DELAYS).exists():
            self.delays.load(checkpoint.load_arrays(delays)["delays"])
            self.ends.append(self.delays.values.copy())

    def packed_gains(self) -> dict[str, np.ndarray]:
        return {"gains": self.gains.values.cpu().numpy()}

    def load_gains(self, arrays: dict[str, np.ndarray]) -> None:
        self.gains.load(torch.from_numpy(arrays["gains"]).to(self.gains.values.device))

    def _expose(self, arrays: dict[str, np.ndarray], own: int) -> None:
        keyframe = min(own, len(arrays["change"]) - 1)  # the next one, if the groups overlap
        self.exposure, self.light = arrays["change"][keyframe], arrays["light"][keyframe]
