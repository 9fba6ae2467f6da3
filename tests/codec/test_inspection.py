"""Verification finds and names every fault of a reel."""

import json
import struct

import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.container import Section, pack_file, unpack_file
from splatreel.codec.inspection import reel_info, verify_reel
from splatreel.codec.reader import ReelReader
from tests.codec.reels import edit_manifest, replace_file, write_reel
from tests.golden import GOLDEN

SOUND, LONG = GOLDEN.parent / "golden-sound", GOLDEN.parent / "golden-long"


@pytest.fixture
def reel(tmp_path):
    return write_reel(tmp_path / "reel")


def test_verify_accepts_a_good_reel(reel):
    found = verify_reel(reel)
    assert (found.files, found.layers, found.groups, found.points) == (5, 2, 2, 60)
    assert verify_reel(reel / "manifest.json") == found


def test_verify_names_a_missing_reel(tmp_path):
    with pytest.raises(ReelError, match=r"manifest\.json: does not exist"):
        verify_reel(tmp_path)


def test_verify_names_a_missing_file(reel):
    (reel / "groups/0001.safetensors").unlink()
    with pytest.raises(ReelError, match=r"0001\.safetensors: does not exist"):
        verify_reel(reel)


def test_verify_names_all_damaged_files(reel):
    group, layer = reel / "groups/0000.safetensors", reel / "layers/0001.safetensors"
    group.write_bytes(group.read_bytes()[:-1])
    data = bytearray(layer.read_bytes())
    data[-1] ^= 1
    layer.write_bytes(data)
    with pytest.raises(ReelError) as error:
        verify_reel(reel)
    assert "groups/0000.safetensors: has" in str(error.value)
    assert "layers/0001.safetensors: its sha256" in str(error.value)


def forge(reel, kind, section, **change):
    """Change a section's parameters in file 0 of a kind, with matching digests."""
    file = reel / kind / "0000.safetensors"
    header, sections = unpack_file(file.read_bytes())
    sections[section] = Section(sections[section].data, sections[section].parameters | change)
    replace_file(reel, kind, 0, pack_file(header, sections))


@pytest.mark.parametrize(
    ("kind", "section", "change"),
    [
        ("layers", "means", {"range": -1}),
        ("layers", "quats", {"bits": 9}),
        ("layers", "sh_rest", {"bits": 16}),
        ("groups", "offsets", {"codec": "av9"}),
        ("groups", "offsets", {"dx_max": [1, 2]}),
        ("groups", "alive", {"count": 21}),
        ("groups", "alive", {"codec": "linear"}),
    ],
)
def test_verify_finds_forged_sections(reel, kind, section, change):
    forge(reel, kind, section, **change)
    with pytest.raises(ReelError, match=rf"{kind}/0000\.safetensors: section '{section}'"):
        verify_reel(reel)


def test_verify_finds_nan(reel):
    file = reel / "layers/0000.safetensors"
    data = file.read_bytes()
    (size,) = struct.unpack_from("<Q", data)
    header = json.loads(data[8 : 8 + size])
    own = json.loads(header["__metadata__"]["splatreel"])
    own["sections"]["sh_base"]["min"] = [float("nan")] * 3
    header["__metadata__"]["splatreel"] = json.dumps(own)
    text = json.dumps(header).encode()
    replace_file(reel, "layers", 0, struct.pack("<Q", len(text)) + text + data[8 + size :])
    with pytest.raises(ReelError, match="NaN is not a finite number"):
        verify_reel(reel)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(frames=99), "99 frames"),
        (lambda d: d["groups"][1].update(points=16), "0001"),
        (lambda d: d["groups"][1].update(first_frame=9), "0001"),
        (lambda d: d["groups"][0].update(frames=2), "0000"),
        (lambda d: d["layers"][0].update(points=21), "0000"),
        (lambda d: d["layers"].pop(), "'alive' holds 30 bits, the layers that live at the group 20"),
        (lambda d: d["groups"][0].update(bytes=10), "0000"),
        (lambda d: d.update(sh_degree=0), "SH degree 1"),
        (lambda d: d["groups"][1].update(uri="groups/0000.safetensors"), "0000"),
    ],
)
def test_verify_finds_manifest_mismatch(reel, change, message):
    edit_manifest(reel, change)
    with pytest.raises(ReelError, match=message):
        verify_reel(reel)


def test_info_sizes_add_up():
    info = reel_info(GOLDEN)
    files = [file for file in GOLDEN.rglob("*") if file.suffix == ".safetensors"]
    sizes = sum(file.stat().st_size for file in files)
    assert sum(info.layer_bytes) + sum(info.group_bytes) == sizes
    assert sum(sum(sections.values()) for sections in info.section_bytes.values()) == sizes
    assert info.bytes == sizes + (GOLDEN / "manifest.json").stat().st_size
    assert info.first_view_bytes == info.bytes - info.layer_bytes[1] - info.group_bytes[1]
    assert info.start_bytes == info.first_view_bytes  # it has no poster
    assert info.total_bytes == info.stored_bytes == info.bytes
    assert info.bytes_per_second == info.bytes / (info.manifest.frames / info.manifest.fps)
    assert max(info.section_bytes["group"], key=info.section_bytes["group"].__getitem__) == "offsets"
    assert info.bytes_per_static_point == sum(info.layer_bytes) / 200
    assert info.float32_bytes == 4 * (59 * 390 + 7 * 8 * 190)


def test_sound_poster_and_thumbnails_count_as_they_are_downloaded():
    info = reel_info(SOUND)
    sizes = {path: path.stat().st_size for path in SOUND.rglob("*") if path.is_file()}
    sound = sum(size for path, size in sizes.items() if path.parent.name == "sound")
    assert sound > 0
    assert info.total_bytes == info.stored_bytes == sum(sizes.values()) == info.bytes + sound
    seconds = info.manifest.frames / info.manifest.fps
    assert info.bytes_per_second == info.total_bytes / seconds
    born_later = sum(layer.bytes for layer in info.manifest.layers if layer.group)
    assert info.playing_bytes_per_second == (sum(info.group_bytes) + born_later + sound) / seconds


def test_stored_bytes_hold_all_renditions():
    info = reel_info(LONG, "low")
    assert info.stored_bytes == sum(
        p.stat().st_size for p in LONG.rglob("*") if p.is_file() and p.name != "expected.json"
    )
    assert info.total_bytes < info.stored_bytes - sum(info.group_bytes)


def test_reader_caches_decoded_files(reel):
    reader = ReelReader(reel)
    assert reader.group(0) is reader.group(0)
    static, born = reader.static(1)
    assert (len(static), born.tolist()) == (30, [0] * 20 + [1] * 10)
    assert len(reader.static(0)[0]) == 20
    with pytest.raises(ReelError, match="2 groups, group 2"):
        reader.group(2)
