"""Memory limits of files: ordinary files stay far below the bound, and files at the bound take the claimed memory."""

import subprocess
import sys

import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.base.memory_budget import A_BYTE, FLOOR, allowed_memory
from splatreel.codec.budget import claimed_memory
from splatreel.codec.container import unpack_file
from splatreel.codec.group_file import decode_group, decode_layer, encode_group, encode_layer
from splatreel.codec.reader import ReelReader
from splatreel.config import EncodeConfig
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from tests.codec.reels import points, write_reel
from tests.golden import random_motion

MEASURE = """
import sys
from pathlib import Path
from splatreel.codec.group_file import decode_group, decode_layer

def resident(what):
    return int(Path("/proc/self/status").read_text().split(what + ":")[1].split()[0]) * 1024

for folder, decode in (("layers", decode_layer), ("groups", decode_group)):
    for golden in ("golden", "golden-predictive"):
        path = Path("tests/data") / golden / folder / "0000.safetensors"
        decode(path.read_bytes(), "it")  # compiled and imported now
for name in sys.argv[1:]:
    data = Path(name).read_bytes()
    Path("/proc/self/clear_refs").write_text("5")
    before = resident("VmRSS")
    (decode_layer if "layer" in name else decode_group)(data, name)
    print(resident("VmHWM") - before)
"""


def equal(count: int, degree: int, spread: bool) -> Gaussians:
    """Return points that take almost no bytes; `spread` gives each its own position for Draco."""
    grid = (
        np.stack(np.unravel_index(np.arange(count), (64, 64, -(-count // 4096))), 1) if spread else np.zeros((count, 3))
    )
    quats, ones = np.tile([1.0, 0, 0, 0], (count, 1)), np.ones((count, 3))
    return Gaussians(grid, quats, ones, np.ones(count), np.zeros((count, (degree + 1) ** 2, 3)))


def still(frames: int, points: Gaussians) -> Group:
    turns = np.tile(np.array([1, 0, 0, 0], np.float32), (frames, len(points), 1))
    return Group(0, 0, points, np.zeros((frames, len(points), 3), np.float32), turns, np.ones(4, bool))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="measures the memory of a process by /proc")
def test_decoding_stays_within_the_memory_bound(tmp_path) -> None:
    """Equal points take few bytes, so only their number counts. Padding makes each file as short as allowed."""
    predictive, paper = EncodeConfig(), EncodeConfig(codec="h265", sh_entries=2)
    files = {
        "layer": encode_layer(0, 0, equal(140_000, 0, False), predictive)[0],
        "layer-colors": encode_layer(0, 0, equal(70_000, 3, False), predictive)[0],
        "group": encode_group(still(70, equal(16_000, 0, False)), predictive)[0],
        "group-long": encode_group(still(200, equal(6000, 1, False)), predictive)[0],
        "layer-paper": encode_layer(0, 0, equal(30_000, 3, True), paper)[0],
        "group-paper": encode_group(still(30, equal(8000, 0, True)), paper)[0],
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    command = [sys.executable, "-c", MEASURE, *(str(tmp_path / name) for name in files)]
    taken = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    for (name, data), peak in zip(files.items(), map(int, taken), strict=True):
        assert peak < allowed_memory(len(data)) + 16e6, name
    assert allowed_memory(1_000_000) < 300e6


@pytest.mark.parametrize(
    "config", [EncodeConfig(coarseness=100.0), EncodeConfig(codec="h265", sh_entries=0).with_h265(crf=51)]
)
def test_padded_files_are_read(config: EncodeConfig) -> None:
    same = equal(140_000, 0, config.codec == "h265")
    data, _ = encode_layer(0, 0, same, config)
    assert len(decode_layer(data, "it")[1]) == len(same)
    slow = still(60, same[:18_000])
    data, _ = encode_group(slow, config)
    assert decode_group(data, "it").dx.shape == slow.dx.shape


@pytest.mark.parametrize("coarseness", [0.3, 2.5])
def test_ordinary_files_are_far_below_the_bound(coarseness: float) -> None:
    """The constant alone would admit these small files, so only the part that grows with length is tested."""
    moving = points(5000, degree=1)
    dx, dq = random_motion(np.random.default_rng(0), moving, 35)
    group = Group(0, 0, moving, 0 * dx, dq, np.ones(0, bool))
    data, _ = encode_group(group, EncodeConfig(coarseness=coarseness))
    header, sections = unpack_file(data)
    assert claimed_memory(header.points, header.frames, sections) < A_BYTE * len(data) / 2


def test_memory_limit_can_be_raised() -> None:
    data, _ = encode_layer(0, 0, points(20), EncodeConfig())
    with pytest.raises(ReelError, match=r"it: claims 20 points in \d+ bytes.* more than the 1 MB .* --max-memory 1\.$"):
        decode_layer(data, "it", most=1000)
    assert len(decode_layer(data, "it", most=FLOOR)[1]) == 20


def test_reader_applies_the_memory_limit(tmp_path) -> None:
    reel = ReelReader(write_reel(tmp_path), most=1000)
    with pytest.raises(ReelError, match="claims 20 points"):
        reel.layer(0)
    with pytest.raises(ReelError, match="claims 3 frames of 15 points"):
        reel.group(0)
