"""Members of damaged zip archives, by compression. A full disk is no damage."""

import errno
import io
import os
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.archives import naming_damage, read_member
from splatreel.base.errors import GaussiansError
from splatreel.base.untrusted import ArrayRows, read_arrays
from splatreel.formats.sog import read_sog
from splatreel.importing.frames import ZipFrames
from tests.importing.films import frame, write_film

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
