"""PLY files that would be read endlessly or wrongly are refused."""

import time
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.base.ply_table import read_elements

VERTEX = "element vertex 1\nproperty uchar x\n"


def write(folder: Path, header: str, body: bytes, order: str = "binary_little_endian") -> Path:
    file = folder / "a.ply"
    file.write_bytes(f"ply\nformat {order} 1.0\n{header}end_header\n".encode() + body)
    return file


def faces(count: int, length: str, item: str = "int") -> str:
    return f"element face {count}\nproperty list {length} {item} vertex_indices\n{VERTEX}"


@pytest.mark.parametrize("kind", ["char", "short", "int"])
@pytest.mark.parametrize("item", ["uchar", "int"])
def test_lists_of_negative_length_are_refused(tmp_path: Path, kind: str, item: str) -> None:
    """Ten billion of them took forever, and one let the point be read a byte early."""
    file = write(tmp_path, faces(9_999_999_999, kind, item), b"\xff" * 32)
    with pytest.raises(GaussiansError, match=r"a\.ply: row 0 of its element face .* claims a list of -1 items"):
        read_elements(file, ("vertex",))


@pytest.mark.parametrize("kind", ["float", "double"])
def test_lengths_of_lists_are_integers(tmp_path: Path, kind: str) -> None:
    file = write(tmp_path, faces(3, kind), np.full(8, np.nan).tobytes())
    with pytest.raises(
        GaussiansError, match=rf"lengths of its list 'vertex_indices' are of type {kind}, expected an int"
    ):
        read_elements(file, ("vertex",))


def test_lists_before_the_points_are_skipped(tmp_path: Path) -> None:
    body = b"".join(bytes([n]) + np.arange(n, dtype="<i4").tobytes() for n in (3, 0, 4))
    found = read_elements(write(tmp_path, faces(3, "uchar"), body + b"\x07"), ("vertex",))
    assert found["vertex"]["x"].tolist() == [7]
    text = write(tmp_path, faces(2, "uchar"), b"3 0 1 2\n0\n7\n", "ascii")
    assert read_elements(text, ("vertex",))["vertex"]["x"].tolist() == [7]


def test_an_element_without_properties_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GaussiansError, match="element vertex has no properties"):
        read_elements(write(tmp_path, "element vertex 3\n", b""), ("vertex",))


def test_a_long_text_of_unclosed_nan_takes_linear_time(tmp_path: Path) -> None:
    """Quadratic time was minutes for this text."""
    file = write(tmp_path, VERTEX, b"nan(" * 100_000, "ascii")
    started = time.process_time()
    with pytest.raises(GaussiansError, match="row 0 of its element vertex"):
        read_elements(file, ("vertex",))
    assert time.process_time() - started < 10


def test_a_damaged_row_behind_nan_of_windows_is_named(tmp_path: Path) -> None:
    header = "element vertex 2\nproperty float x\nproperty float y\n"
    file = write(tmp_path, header, b"nan(ind) 1\n2 zero\n", "ascii")
    with pytest.raises(GaussiansError, match="row 1 of its element vertex"):
        read_elements(file, ("vertex",))
