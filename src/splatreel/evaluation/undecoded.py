"""A reconstruction before it was encoded: what the cost of compression is measured against."""

from __future__ import annotations

from pathlib import Path

from splatreel.codec.manifest import FileEntry
from splatreel.codec.reader import ReelReader
from splatreel.play.timeline import Timeline
from splatreel.recon import checkpoint
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


class UndecodedReel(ReelReader):
    """The same reel with the points and offsets of the checkpoints in place of the decoded files.

    reel: the encoded one, for its manifest. work: the folder of checkpoints it was made from. `frame(f)` gives what
    `evaluate` wants for psnr_undecoded. Raises `ReconstructionError` for checkpoints that cannot be read.
    """

    def __init__(self, reel: str | Path, work: Path) -> None:
        super().__init__(reel)
        self._work = work
        self._timeline = Timeline(self)

    def frame(self, frame: int) -> Gaussians:
        """Everything visible at a frame."""
        return self._timeline.at(frame / self.fps)

    def layer(self, index: int) -> Gaussians:
        entry = self.manifest.layers[index]
        return checkpoint.unpack(checkpoint.load_arrays(self._folder(entry.group) / "layer.safetensors"), "raw_")

    def _load_group(self, entry: FileEntry) -> Group:
        arrays = checkpoint.load_arrays(self._folder(entry.group) / "group.safetensors")
        alive = arrays["alive"].astype(bool)
        return Group(entry.group, entry.first_frame, checkpoint.unpack(arrays), arrays["dx"], arrays["dq"], alive)

    def _folder(self, group: int) -> Path:
        return self._work / f"group{group:04d}"
