"""Untrusted files that are too large, nested, endless or of another kind are refused before allocation."""

from __future__ import annotations

import errno
import io
import json
import os
import pickle
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from splatreel.base import untrusted
from splatreel.base.errors import CaptureError, GaussiansError
from splatreel.base.untrusted import (
    ArrayRows,
    load_arrays,
    naming_damage,
    numbers,
    parse_json,
    parse_xml,
    read_array,
    read_arrays,
    read_json,
    read_member,
)
from splatreel.formats.sog import read_sog
from splatreel.importing.frames import ZipFrames
from tests.importing.films import frame, write_film

posix = pytest.mark.skipif(os.name != "posix", reason="pipes and devices")


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def lying(shape: tuple[int, ...], dtype: str = "<f4") -> bytes:
    """Return an array's header without its numbers."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": False, "shape": shape})
    return file.getvalue()


def archive(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            file.writestr(f"{name}.npy", data)
    return path


def test_valid_files_are_read(tmp_path: Path) -> None:
    value = {"a": [1, 2.5, {"b": "[[[[{{{{,,,,\\" * 100}], "c": None, "d": "ä"}
    (tmp_path / "a.json").write_text(json.dumps(value, ensure_ascii=False), encoding="utf-8")
    assert read_json(tmp_path / "a.json", CaptureError) == value
    rng = np.random.default_rng(0)
    arrays = {
        "x": rng.random((3, 4)),
        "y": np.arange(5),
        "z": np.zeros((0, 3)),
        "f": np.asfortranarray(rng.random((2, 3))),
    }
    np.savez(tmp_path / "a.npz", **arrays)
    for name, found in read_arrays(tmp_path / "a.npz", arrays, CaptureError).items():
        np.testing.assert_array_equal(found, arrays[name])
    np.save(tmp_path / "a.npy", arrays["f"])
    np.testing.assert_array_equal(read_array(tmp_path / "a.npy", CaptureError), arrays["f"])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "nested more than 64 deep"),
        ('{"a":' * 65 + "1" + "}" * 65, "nested more than 64 deep"),
        ("[" + "{}," * 2_000_001 + "{}]", "holds more than 2,000,000 values"),
        ("{", "is not JSON"),
        ('"\\ud800"', "half a character"),
        ("[" + "9" * 5000 + "]", "is not JSON"),
        (b"\xff\xfe", "is not JSON"),
        ('"' + "\\", "is not JSON"),
    ],
)
def test_invalid_json_is_refused(text: str | bytes, said: str) -> None:
    with pytest.raises(CaptureError, match=said) as caught:
        parse_json(text, CaptureError, "a.json:")
    assert str(caught.value).startswith("a.json:")


def test_json_values_are_counted_before_allocation() -> None:
    text = b"[" + b"{}," * 2_500_000 + b"{}]"
    tracemalloc.start()
    with pytest.raises(CaptureError, match="values"):
        parse_json(text, CaptureError, "a.json:")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * len(text), "built, they would take thirty times as much"


@pytest.mark.parametrize("text", ["[" * 70 + "]" * 70, "[" * 64 + "]" * 64])
def test_json_depth_is_counted_across_blocks(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(untrusted, "_BLOCK", 7)
    if len(text) > 128:
        with pytest.raises(CaptureError, match="nested"):
            parse_json(text, CaptureError, "")
    else:
        parse_json(text, CaptureError, "")


@posix
@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_pipes_do_not_block(tmp_path: Path, kind: str) -> None:
    path = {"pipe": tmp_path / "pipe", "device": Path("/dev/zero"), "folder": tmp_path}[kind]
    if kind == "pipe":
        os.mkfifo(path)
    for read in (
        lambda: read_json(path, CaptureError),
        lambda: read_array(path, CaptureError),
        lambda: read_arrays(path, ["x"], CaptureError),
    ):
        with pytest.raises(CaptureError, match=f"{path}: is (a pipe or a device|a folder), expected a file"):
            read()


def test_file_size_is_limited(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[1, 2, 3]")
    assert read_json(tmp_path / "a.json", CaptureError, 9) == [1, 2, 3]
    with pytest.raises(CaptureError, match=r"a\.json: has 9 bytes, more than the 8"):
        read_json(tmp_path / "a.json", CaptureError, 8)


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.zeros(3, np.complex64), "x is of complex64, expected an array of plain numbers"),
        (np.zeros(3, "datetime64[s]"), "expected an array of plain numbers"),
        (np.zeros(3, bool), "x is of bool"),
        (np.array(["1", "2"]), "expected an array of plain numbers"),
        (np.zeros(3, [("a", "<f4")]), "expected an array of plain numbers"),
        (np.zeros(3, np.longdouble), "expected an array of plain numbers"),
    ],
)
def test_arrays_of_other_types_are_refused(tmp_path: Path, array: np.ndarray, said: str) -> None:
    if array.dtype.itemsize == 8 and array.dtype.kind == "f":
        pytest.skip("here long doubles are doubles")
    with pytest.raises(CaptureError, match=said):
        read_arrays(archive(tmp_path / "a.npz", x=npy(array)), ["x"], CaptureError)


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{}, None], object), allow_pickle=True)
    with pytest.raises(CaptureError, match=r"a\.npy: is of object"):
        read_array(tmp_path / "a.npy", CaptureError)


def damaged(data: bytes) -> bytes:
    place = data.index(b"NUMPY") + 60
    return data[:place] + bytes(64) + data[place + 64 :]


def encrypted(data: bytes) -> bytes:
    """Return an archive whose members are marked as encrypted."""
    out = bytearray(data)
    for mark, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        out[data.index(mark) + offset] |= 1
    return bytes(out)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data[: len(data) // 2], "is not an archive of arrays, or damaged"),
        (lambda data: b"", "is not an archive of arrays, or damaged"),
        (encrypted, "x is encrypted"),
        (lambda data: data.replace(b"\x08\x00", b"\x63\x00"), "x is in a compression that NumPy does not write"),
    ],
    ids=["half", "empty", "encrypted", "another method"],
)
def test_invalid_archives_are_refused(tmp_path: Path, change, said: str) -> None:
    path = archive(tmp_path / "a.npz", x=npy(np.random.default_rng(0).random(1000)))
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(CaptureError, match=said):
        read_arrays(path, ["x"], CaptureError)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (lying((1 << 40, 3)), "need 13,194,139,533,312 bytes"),
        (lying((-1, 3)), "ends early|not a NumPy array"),
        (b"no array at all", "is not a NumPy array of plain numbers"),
        (b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535, "is not a NumPy array of plain numbers"),
    ],
)
def test_false_headers_allocate_nothing(tmp_path: Path, data: bytes, said: str) -> None:
    with pytest.raises(CaptureError, match=said):
        read_arrays(archive(tmp_path / "a.npz", x=data), ["x"], CaptureError)
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises(CaptureError, match=said):
        read_array(tmp_path / "a.npy", CaptureError)


def test_zip_bombs_are_refused(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.npz", x=npy(np.zeros(10_000_000)), y=npy(np.zeros(10)))
    tracemalloc.start()
    with pytest.raises(CaptureError, match=r"would unpack [0-9,]+ bytes to 80,000,[0-9]+, .* --max-memory 81"):
        read_arrays(path, ["x", "y"], CaptureError)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 19
    assert read_arrays(path, ["y"], CaptureError)["y"].shape == (10,)
    assert read_arrays(path, ["x"], CaptureError, 81_000_000)["x"].shape == (10_000_000,)


@pytest.mark.parametrize("text", [b'"' + b"\\n" * 500_000 + b'"', b'"' + b"\\n" * 500_000])
def test_escapes_take_memory_in_proportion_to_the_text(text: bytes) -> None:
    """A pattern that could backtrack at each escape took over a hundred bytes for each."""
    tracemalloc.start()
    try:
        parse_json(text, CaptureError, "it")
    except CaptureError:
        assert text.endswith(b"\\n")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * len(text)


@pytest.mark.parametrize(
    "value", [["1", 2], [True, 2], [float("nan"), 1], [float("inf"), 1], [10**400, 1], [1], 5, None]
)
def test_is_number_accepts_only_finite_numbers(value: object) -> None:
    np.testing.assert_array_equal(numbers([1, 2.5], 2), [1, 2.5])
    with pytest.raises(ValueError, match="is no"):
        numbers(value, 2)


class Evil:
    def __reduce__(self) -> tuple[object, ...]:
        return print, ("run by a pickle",)


def test_pickles_may_hold_nothing_but_arrays(capsys: pytest.CaptureFixture[str]) -> None:
    found = load_arrays(pickle.dumps({"a": np.arange(3.0)}, protocol=3))
    np.testing.assert_array_equal(found["a"], [0, 1, 2])
    with pytest.raises(pickle.UnpicklingError, match=r"asks for builtins\.print"):
        load_arrays(pickle.dumps(Evil()))
    assert not capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<a>" * 100 + "</a>" * 100, "nested more than 64 deep"),
        ("<a>" * 3_000_000, "nested more than 64 deep"),
        ("<a>", "is not a complete XML file"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "declares a document type"),
    ],
)
def test_hostile_xml_is_refused(text: str, said: str) -> None:
    with pytest.raises(CaptureError, match=f"a.xml: .*{said}"):
        parse_xml(text, CaptureError, "a.xml:")
    assert [child.tag for child in parse_xml("<a><b/><c/></a>", CaptureError, "")] == ["b", "c"]


COMPRESSIONS = {"bzip2": zipfile.ZIP_BZIP2, "lzma": zipfile.ZIP_LZMA, "deflate": zipfile.ZIP_DEFLATED}
compressions = pytest.mark.parametrize("compression", COMPRESSIONS.values(), ids=COMPRESSIONS)


def damage(file: Path, name: str, at: float) -> None:
    """Overwrite bytes of a member, at a share of its length."""
    with zipfile.ZipFile(file) as archive:
        info = archive.getinfo(name)
    data = bytearray(file.read_bytes())
    start = info.header_offset + 30 + len(name) + int(at * info.compress_size)
    data[start : start + 12] = b"\xff" * 12
    file.write_bytes(data)


@compressions
@pytest.mark.parametrize("at", [0.0, 0.1, 0.5])
def test_damaged_members_are_named(tmp_path: Path, compression: int, at: float) -> None:
    write_film(tmp_path / "film", [frame(0)])
    (source,) = (tmp_path / "film").iterdir()
    for name, read in {
        f"a{source.suffix}": lambda file: ZipFrames(file).read(0),
        "meta.json": read_sog,
        "means3D.npy": lambda file: read_arrays(file, ["means3D"], GaussiansError),
        "rows.npy": lambda file: ArrayRows(file, "rows", GaussiansError)[0],
    }.items():
        numbers = io.BytesIO()
        np.save(numbers, np.random.default_rng(0).random((1, 500)))
        file = tmp_path / f"{Path(name).stem}.zip"
        with zipfile.ZipFile(file, "w", compression) as archive:
            archive.writestr(name, source.read_bytes() if name[0] == "a" else numbers.getvalue())
        damage(file, name, at)
        with pytest.raises(GaussiansError) as caught:
            read(file)
        assert str(file) in str(caught.value)


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EIO])
def test_errors_of_the_system_are_not_called_damage(code: int) -> None:
    message = rf"a\.zip: cannot be read \({os.strerror(code)}\)"
    with pytest.raises(GaussiansError, match=message), naming_damage("a.zip", GaussiansError):
        raise OSError(code, os.strerror(code))


def test_members_that_hold_more_than_they_state_take_bounded_memory(tmp_path: Path) -> None:
    file = tmp_path / "bomb.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("a", bytes(80 << 20))
    with zipfile.ZipFile(file) as archive:
        info = archive.getinfo("a")
        info.file_size = 1000
        tracemalloc.start()
        with pytest.raises(zipfile.BadZipFile, match="CRC"):
            read_member(archive, info)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 70 << 20


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA], ids=["bzip2", "lzma"])
def test_arrays_in_compressions_that_numpy_does_not_write_are_refused(tmp_path: Path, compression: int) -> None:
    numbers = io.BytesIO()
    np.save(numbers, np.zeros((2, 3)))
    with zipfile.ZipFile(tmp_path / "a.npz", "w", compression) as archive:
        archive.writestr("x.npy", numbers.getvalue())
    with pytest.raises(GaussiansError, match=r"a\.npz: x is in a compression that NumPy does not write"):
        read_arrays(tmp_path / "a.npz", ["x"], GaussiansError)
    with pytest.raises(GaussiansError, match=r"a\.npz: x is in a compression that NumPy does not write"):
        ArrayRows(tmp_path / "a.npz", "x", GaussiansError)


def test_member_with_a_name_longer_than_a_file_may_have_is_read(tmp_path: Path) -> None:
    write_film(tmp_path / "film", [frame(0)])
    (source,) = (tmp_path / "film").iterdir()
    with zipfile.ZipFile(tmp_path / "film.zip", "w") as archive:
        archive.write(source, f"{'x' * 300}{source.suffix}")
    assert len(ZipFrames(tmp_path / "film.zip").read(0)) == len(frame(0))
