"""Memory of imports: small files that claim much are refused before allocation, and honest files stay below the limit."""

import gzip
import json
import struct
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import FLOOR, points_memory
from splatreel.formats.registry import FRAME_FORMATS, Placement, read_splats
from splatreel.formats.splat_columns import Remarks
from splatreel.importing.frames import open_frames
from tests.golden import random_gaussians

MANY = 8_000_000
"""Points that no small file may claim."""


def spz(path: Path) -> Path:
    head = struct.pack("<IIIBBBB", 0x5053474E, 3, MANY, 0, 12, 0, 0)
    path.write_bytes(gzip.compress(head + bytes(1_000_000)))
    return path


def spz4(path: Path) -> Path:
    zstandard = pytest.importorskip("zstandard")
    head = struct.pack("<IIIBBBBI", 0x5053474E, 4, 30, 0, 12, 0, 5, 32).ljust(32, b"\0")
    parts = [zstandard.ZstdCompressor().compress(bytes(100_000_000)) for _ in range(5)]
    table = b"".join(
        struct.pack("<QQ", len(part), size) for part, size in zip(parts, (270, 30, 90, 90, 120), strict=True)
    )
    path.write_bytes(head + table + b"".join(parts))
    return path


def sog(path: Path, count: int = MANY, size: tuple[int, int] = (4, 4), escapes: int = 0) -> Path:
    width, height = size
    bits = (width - 1) | (height - 1) << 14
    image = b"RIFF" + struct.pack("<I", 30) + b"WEBPVP8L" + struct.pack("<I", 20) + b"\x2f" + struct.pack("<I", bits)
    names = {
        name: {"files": [f"{name}.webp"] * 2, "codebook": [0.0] * 256} for name in ("means", "scales", "quats", "sh0")
    }
    meta = json.dumps({"version": 2, "count": count} | names).encode()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.json", b'"' + b"\\n" * escapes + b'"' if escapes else meta)
        for name in names:
            archive.writestr(f"{name}.webp", image + bytes(30))
    return path


def zip_of_zeros(path: Path, points: int = 2_000_000) -> Path:
    names = ["x", "y", "z", "opacity", *(f"f_dc_{i}" for i in range(3)), *(f"scale_{i}" for i in range(3))]
    names += [f"rot_{i}" for i in range(4)]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {points}"]
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("f0.ply", "\n".join(header).encode() + bytes(4 * len(names) * points))
    return path


def npz(path: Path) -> Path:
    points = 1_000_000
    arrays = {
        "means3D": np.zeros((2, points, 3), np.float32),
        "rgb_colors": np.zeros((2, points, 3), np.float32),
        "unnorm_rotations": np.zeros((2, points, 4), np.float32),
        "logit_opacities": np.zeros((points, 1), np.float32),
        "log_scales": np.zeros((points, 3), np.float32),
    }
    np.savez_compressed(path, **arrays)
    return path


@contextmanager
def at_most(most: float) -> Iterator[None]:
    """Check the highest amount of memory that Python and NumPy allocate."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


BOMBS: dict[str, Callable[[Path], Path]] = {
    "a.spz": spz,
    "a.zip": zip_of_zeros,
    "params.npz": npz,
    "count.sog": sog,
    "image.sog": lambda path: sog(path, 10, (16384, 16384)),
}


@pytest.mark.parametrize("name", list(BOMBS))
def test_small_files_that_claim_much_are_refused_before_allocation(tmp_path: Path, name: str) -> None:
    path = BOMBS[name](tmp_path / name)
    assert path.stat().st_size < 1_000_000
    with (
        at_most(10e6),
        pytest.raises(GaussiansError, match=r"MB of memory, more than the .* --max-memory \d+") as caught,
    ):
        open_frames(path).read(0)
    assert str(path) in str(caught.value)


def test_stated_sizes_of_zstd_frames_are_not_allocated(tmp_path: Path) -> None:
    path = spz4(tmp_path / "a.spz")
    with at_most(10e6), pytest.raises(GaussiansError, match="100000000 of 270 bytes"):
        open_frames(path).read(0)


@pytest.mark.parametrize("escapes", [1_000_000, 10_000_000])
def test_descriptions_of_escapes_are_refused(tmp_path: Path, escapes: int) -> None:
    path = sog(tmp_path / "a.sog", escapes=escapes)
    with at_most(40e6), pytest.raises(GaussiansError, match=r"a\.sog"):
        open_frames(path).read(0)


def test_constant_streams_of_4dgs_files_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("fourdgs")
    from fourdgs import opcode, serialization  # pyright: ignore[reportMissingImports] - optional
    from fourdgs.records import encode_chunk  # pyright: ignore[reportMissingImports] - optional

    count = 20_000_000
    body = serialization.compress(bytes(3), 0, 6)
    stream = struct.pack("<BBBBBIQ", 1, 1, 2, 0, 3, count, len(body)) + body
    data = serialization.MAGIC + encode_chunk(0.0, 1.0, 0, 10, stream * 15)
    band = serialization.put_record(opcode.SH_BAND_STREAM, b"\x01" + stream)
    for name, content in {"chunk.4dgs": data, "band.4dgs": serialization.MAGIC + band * 15}.items():
        (tmp_path / name).write_bytes(content)
        with at_most(20e6), pytest.raises(GaussiansError, match=r"streams of repeated numbers in .* --max-memory"):
            open_frames(tmp_path / name)


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("kind", ["ply", "compressed-ply", "splat", "sog", "spz"])
def test_honest_files_take_less_than_is_claimed_and_much_less_than_is_allowed(
    tmp_path: Path, kind: str, degree: int
) -> None:
    count = 4000
    points = random_gaussians(np.random.default_rng(0), count, degree, (0, 0, 0))
    path = tmp_path / f"f{FRAME_FORMATS[kind].suffix}"
    FRAME_FORMATS[kind].write(path, points, Placement(np.array([1.0, 0, 0, 0])))
    size = path.stat().st_size
    read_splats(path, None, Remarks())
    claimed = size + points_memory(count, 3 * ((degree + 1) ** 2 - 1) if kind != "splat" else 0)
    with at_most(1.2 * claimed + 1e6):
        read_splats(path, None, Remarks())
    assert claimed < 256 * size, "a film of millions of such points is read"


def test_limit_can_be_raised_and_lowered(tmp_path: Path) -> None:
    film = zip_of_zeros(tmp_path / "a.zip", 200_000)
    with pytest.raises(GaussiansError, match="--max-memory"):
        open_frames(film).read(0)
    assert len(open_frames(film, most=200_000_000).read(0)) == 200_000
    path = tmp_path / "f.splat"
    FRAME_FORMATS["splat"].write(
        path, random_gaussians(np.random.default_rng(0), 4000, 0, (0, 0, 0)), Placement(np.array([1.0, 0, 0, 0]))
    )
    assert FLOOR > 1_000_000
    with pytest.raises(GaussiansError, match=r"f\.splat: claims 4,000 points"):
        open_frames(path, most=1_000_000).read(0)
