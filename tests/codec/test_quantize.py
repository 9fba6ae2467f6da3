"""Bit packing and linear quantization: known answers, round trips, hostile parameters."""

import subprocess
import sys
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base.errors import ReelError
from splatreel.base.memory_budget import A_BYTE, FLOOR, allowed_memory
from splatreel.codec import quantize
from splatreel.codec.container import unpack_file
from splatreel.codec.group_file import decode_group, decode_layer, encode_group, encode_layer
from splatreel.codec.quantize import claimed_memory
from splatreel.codec.reader import ReelReader
from splatreel.config import EncodeConfig
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from tests.codec.reels import points, write_reel
from tests.golden import random_motion


def test_pack_known_answers():
    assert quantize.pack(np.array([1, 0, 1, 1]), 1) == bytes([0b1101])
    # Low bytes, then 1 and 4, low first.
    assert quantize.pack(np.array([0x123, 0x456]), 12) == bytes([0x23, 0x56, 0x41])
    assert quantize.pack(np.array([0x1234]), 16) == bytes([0x34, 0x12])
    assert quantize.pack(np.array([7, 200]), 8) == bytes([7, 200])


@settings(deadline=None)
@given(st.integers(1, 16), st.integers(0, 50), st.integers(0, 2**32 - 1))
def test_pack_round_trip(bits, count, seed):
    values = np.random.default_rng(seed).integers(0, 1 << bits, count).astype(np.uint16)
    data = quantize.pack(values, bits)
    assert len(data) == quantize.packed_size(count, bits) == -(-count * bits // 8)
    np.testing.assert_array_equal(quantize.unpack(data, bits, count), values)
    with pytest.raises(ReelError, match="bytes"):
        quantize.unpack(data + b"x", bits, count)


@settings(deadline=None)
@given(st.integers(1, 16), st.integers(1, 40), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_linear_error_is_at_most_half_a_step(bits, rows, columns, seed):
    values = np.random.default_rng(seed).normal(size=(rows, columns)) * 10.0 ** np.arange(columns)
    data, parameters = quantize.encode_linear(values, bits)
    decoded = quantize.decode_linear(data, parameters, rows, columns)
    half_step = np.ptp(values, axis=0) / ((1 << bits) - 1) / 2
    assert (np.abs(decoded - values) <= half_step + 1e-6 * np.abs(values).max(0)).all()


def test_constant_column_is_exact():
    data, parameters = quantize.encode_linear(np.full((9, 2), 0.25), 8)
    np.testing.assert_array_equal(quantize.decode_linear(data, parameters, 9, 2), 0.25)


def test_logarithms_keep_small_scales():
    """Over three decades, 12 logarithmic bits have an error of 0.1 %; 12 linear bits have an error above a point's size."""
    scales = np.exp(np.random.default_rng(0).normal(-4, 1.2, (5000, 3)))
    worst = {}
    for log in (True, False):
        data, parameters = quantize.encode_linear(scales, 12, log)
        assert parameters.get("log", False) == log
        worst[log] = np.abs(quantize.decode_linear(data, parameters, 5000, 3) / scales - 1).max()
    assert worst[True] < 2e-3
    assert worst[False] > 0.5


def test_deflate_is_used_only_if_shorter():
    assert quantize.deflate(bytes(1000))[1]
    noise = np.random.default_rng(0).bytes(1000)
    assert quantize.deflate(noise) == (noise, False)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bits": 0}, "bits"),
        ({"bits": 17}, "bits"),
        ({"bits": True}, "bits"),
        ({"bits": "8"}, "bits"),
        ({"min": [0.0]}, "min"),
        ({"min": [float("nan"), 0.0]}, "finite"),
        ({"max": [float("inf"), 0.0]}, "finite"),
        ({"max": [10**400, 0]}, "finite"),
        ({"max": None}, "max"),
        ({"min": [9.0, 9.0]}, "above"),
        ({"log": True, "max": [1e3, 1e3]}, "logarithms"),
        ({"log": 1}, "log"),
        ({"deflate": "yes"}, "deflate"),
        ({"deflate": True}, "zlib"),
    ],
)
def test_hostile_parameters_are_refused(change, message):
    data, parameters = quantize.encode_linear(np.random.default_rng(0).random((20, 2)), 8)
    assert not parameters["deflate"]
    with pytest.raises(ReelError, match=message):
        quantize.decode_linear(data, parameters | change, 20, 2)


def test_deflate_bombs_are_refused():
    bomb = zlib.compress(bytes(50_000_000), 9)
    with pytest.raises(ReelError, match="does not inflate"):
        quantize.inflate(bomb, {"deflate": True}, 100)


@settings(deadline=None)
@given(st.lists(st.booleans(), max_size=100))
def test_bits_round_trip(flags):
    flags = np.array(flags, bool)
    data, parameters = quantize.encode_bits(flags)
    np.testing.assert_array_equal(quantize.decode_bits(data, parameters, 100), flags)


def test_huge_bit_counts_are_refused():
    with pytest.raises(ReelError, match="count"):
        quantize.decode_bits(b"", {"codec": "bits", "count": 1 << 50}, 1000)


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
