from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from splatreel.config import Config, GroupConfig
from splatreel.progress import Silent
from splatreel.recon import checkpoint
from splatreel.recon.rig import Rig
from tests.recon.captures import WallCapture

CPU = torch.device("cpu")
CONFIG = Config(even_exposure=True, group=GroupConfig(delays=True))
CAPTURE = WallCapture(6, speed=0.0, drift=0.1)
NAMES = [camera.name for camera in CAPTURE.cameras]


class Notes(Silent):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def note(self, text: str) -> None:
        self.lines.append(text)


def test_exposures_go_on_from_group_to_group_and_a_restored_rig_knows_as_much(tmp_path: Path) -> None:
    rig, notes = Rig(NAMES, CONFIG, CPU), Notes()
    rig.gains.load(torch.rand(len(NAMES), 3))
    for first, folder in ((0, tmp_path / "a"), (3, tmp_path / "b")):
        folder.mkdir()
        frames = CAPTURE.read(first, min(4, 6 - first), NAMES)
        rig.even_out(frames, 3, folder, notes)
        assert np.abs(frames.astype(float) - CAPTURE.read(0, 1, NAMES)[0]).mean() < 1.5
        rig.delays.load(np.linspace(-0.3, 0.3, len(NAMES)) + first / 100)
        rig.keep_delays(folder, notes)
        checkpoint.save_arrays(folder / "keyframe.safetensors", rig.packed_gains())
        other = Rig(NAMES, CONFIG, CPU)
        other.restore(3, folder)
        assert np.array_equal(other.exposure, rig.exposure)
        assert np.array_equal(other.delays.values, rig.delays.values)
        assert torch.equal(other.gains.values, rig.gains.values)
    assert "exposures change by up to" in notes.lines[0]
    assert notes.lines[1] == f"cameras are out of step, {NAMES[0]} is 0.30 frames early: allowed for"


@pytest.mark.parametrize("restored", [False, True])
def test_what_is_off_is_not_written_and_changes_nothing(tmp_path: Path, restored: bool) -> None:
    rig, notes = Rig(NAMES, replace(CONFIG, even_exposure=False, group=GroupConfig()), CPU), Notes()
    frames = CAPTURE.read(0, 6, NAMES)
    before = frames.copy()
    rig.even_out(frames, 3, tmp_path, notes)
    rig.keep_delays(tmp_path, notes)
    if restored:
        rig.restore(3, tmp_path)
    assert np.array_equal(frames, before)
    assert not rig.exposure.any()
    assert not rig.delays.values.any()
    assert not notes.lines
    assert not list(tmp_path.iterdir())
