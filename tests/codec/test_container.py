"""Layer and group files: content and detection of damage."""

import contextlib
import json
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import ReelError, StorageError
from splatreel.codec.container import FileHeader, Section, pack_file, unpack_file
from splatreel.codec.group_file import decode_group, decode_layer, encode_group, encode_layer
from splatreel.config import EncodeConfig
from tests.codec.reels import CONFIG, new_group, points

HEADER = FileHeader("group", 3, 7, 90, 35)
SECTIONS = {"a": Section(b"hello", {"codec": "x", "n": 1}), "b": Section(b"", {"codec": "y"})}


def with_header(change) -> bytes:
    """Return a file with its safetensors header changed."""
    data = pack_file(HEADER, SECTIONS)
    (size,) = struct.unpack_from("<Q", data)
    header = json.loads(data[8 : 8 + size])
    text = json.dumps(change(header) or header).encode()
    return struct.pack("<Q", len(text)) + text + data[8 + size :]


def with_metadata(change) -> bytes:
    def edit(header):
        own = json.loads(header["__metadata__"]["splatreel"])
        own.update(change)
        header["__metadata__"]["splatreel"] = json.dumps(own)

    return with_header(edit)


def test_container_round_trip():
    assert unpack_file(pack_file(HEADER, SECTIONS)) == (HEADER, SECTIONS)


def test_file_is_valid_safetensors():
    assert bytes(load(pack_file(HEADER, SECTIONS))["a"]) == b"hello"


def test_unknown_sections_and_fields_are_ignored():
    data = with_metadata({"color": "green"})
    assert unpack_file(data) == (HEADER, SECTIONS)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "safetensors"),
        (b"\xff" * 100, "safetensors"),
        (struct.pack("<Q", 2) + b"[]", "not a JSON object"),
        (struct.pack("<Q", 2) + b"{}", "metadata"),
        (struct.pack("<Q", 3) + b"{a}", "not JSON"),
        (struct.pack("<Q", 100_000) + b"[" * 100_000, "nested more than 64 deep"),
        (with_metadata({"version": 2}), "version 2"),
        (with_metadata({"version": True}), "version True"),
        (with_metadata({"kind": "movie"}), "movie"),
        (with_metadata({"points": -1}), "points"),
        (with_metadata({"frames": 0}), "frames"),
        (with_metadata({"sections": []}), "sections"),
        (with_metadata({"sections": {"a": 3}}), "sections"),
        (with_metadata({"sections": {"zzz": {}}}), "'zzz'"),
        (with_header(lambda h: h["a"].update(data_offsets=[0, 1 << 50])), "section 'a'"),
        (with_header(lambda h: h["a"].update(data_offsets=[4, 2])), "section 'a'"),
        (with_header(lambda h: h["a"].update(data_offsets=[0.5, 5.0])), "section 'a'"),
        (with_header(lambda h: h["a"].update(data_offsets=[-5, 0])), "section 'a'"),
        (with_header(lambda h: h["a"].update(dtype="F32")), "section 'a'"),
        (with_header(lambda h: h["a"].update(shape=[6])), "section 'a'"),
    ],
)
def test_hostile_files_are_refused(data, message):
    with pytest.raises(ReelError, match=message):
        unpack_file(data)


def test_layer_is_refused_as_group():
    layer, _ = encode_layer(0, 0, points(5), CONFIG)
    group, _ = encode_group(new_group(0, 5, 5), CONFIG)
    with pytest.raises(ReelError, match=r"^here: is a group file"):
        decode_layer(group, "here")
    with pytest.raises(ReelError, match=r"^here: is a layer file"):
        decode_group(layer, "here")


FILES = [
    (decode, data)
    for config in (CONFIG, EncodeConfig(codec="predictive"))
    for decode, data in (
        (decode_layer, encode_layer(0, 0, points(40), config)[0]),
        (decode_group, encode_group(new_group(0, 20, 9), config)[0]),
    )
]


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(FILES), st.data())
def test_damaged_file_raises_reel_error_or_decodes(file, data):
    """Truncation or changed bytes never cause other exceptions, crashes or endless work."""
    decode, whole = file
    damaged = bytearray(whole)
    for at in data.draw(st.lists(st.integers(0, len(damaged) - 1), max_size=4)):
        damaged[at] = data.draw(st.integers(0, 255))
    del damaged[data.draw(st.integers(0, 2 * len(damaged))) :]
    with contextlib.suppress(ReelError):
        decode(bytes(damaged), "some file")


def test_full_disk_keeps_the_old_file(tmp_path, monkeypatch):
    file = tmp_path / "sub" / "a.bin"
    write_bytes(file, b"old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(StorageError, match=r"a\.bin: could not write 3 bytes \(No space left on device\)"):
        write_bytes(file, b"new")
    assert file.read_bytes() == b"old"
    assert [p.name for p in file.parent.iterdir()] == ["a.bin"]


def test_unpaired_surrogate_in_metadata_is_refused() -> None:
    data = pack_file(HEADER, SECTIONS).replace(b'\\"kind\\"', b'\\"\\\\ud800"', 1)
    with pytest.raises(ReelError):
        unpack_file(data)
    own = json.dumps({"__metadata__": {"splatreel": "\ud800"}}).encode()
    with pytest.raises(ReelError, match="half a character"):
        unpack_file(len(own).to_bytes(8, "little") + own)
