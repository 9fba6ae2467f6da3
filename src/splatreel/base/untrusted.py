"""Safe opening of files from untrusted sources, and safe readers of JSON, XML, NumPy files and zip archives.

A file may be a pipe or a device, endless, deeply nested, or expand to a thousand times its size. Limits are checked
before the content is read. Every fault raises the caller's error type with the name of the file.
"""

from __future__ import annotations

import io
import json
import lzma
import math
import os
import pickle
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, TypeGuard
from xml.etree import ElementTree

import numpy as np

from splatreel.base.errors import SplatreelError
from splatreel.base.memory_budget import allowed_memory, in_megabytes

_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError, NotImplementedError, RuntimeError),
    *(ValueError, TypeError, KeyError, IndexError, struct.error),
)
"""Errors of `zipfile` for damaged members, by their compression, and of code that reads damaged values."""
_BLOCK, _SMALL_BLOCK = 1 << 20, 4096
"""Bytes that are unpacked at a time. `zipfile` unpacks as many packed bytes of bzip2 and LZMA without any limit."""
_BOUNDED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


@contextmanager
def naming_damage(
    subject: str, kind: Callable[[str], SplatreelError], what: str = "damaged", remedy: str = "Copy it again."
) -> Iterator[None]:
    """Turn whatever a damaged archive makes a parser raise into an error that starts with `subject`.

    Errors of the system, such as a full disk, are not called damage.

    Args:
        subject: Name of the file or member.
        kind: Error constructor.
        what: State of a damaged file, which follows "is" in the message.
        remedy: Last sentence of the message.
    """
    try:
        yield
    except _DAMAGE as error:
        if isinstance(error, OSError) and error.errno is not None:  # bzip2 raises OSError without a number
            raise kind(f"{subject}: cannot be read ({error.strerror}).") from error
        raise kind(f"{subject}: is {what} ({error!s:.80}). {remedy}") from error


def copy_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, target: IO[bytes]) -> None:
    """Unpack a member into an open file, in bounded memory even if it holds more than it states."""
    block = _BLOCK if info.compress_type in _BOUNDED else _SMALL_BLOCK
    with archive.open(info) as source:
        while data := source.read(block):
            target.write(data)


def read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """Return the content of a member, in little more memory than it states."""
    data = io.BytesIO()
    copy_member(archive, info, data)
    return data.getvalue()


def check_array_member(info: zipfile.ZipInfo, subject: str, kind: Callable[[str], SplatreelError]) -> None:
    """Refuse a member that is encrypted or of a compression that NumPy does not write."""
    if info.flag_bits & 1:
        raise kind(f"{subject} is encrypted. Save it without a password.")
    if info.compress_type not in _BOUNDED:
        raise kind(f"{subject} is in a compression that NumPy does not write. Save it with numpy.savez_compressed.")


JSON_BYTES = 64 << 20
"""Default maximum size of a JSON file."""
JSON_VALUES = 2_000_000
"""Default maximum number of JSON values. Each takes about a hundred bytes of memory."""
JSON_DEPTH = 64
"""Maximum nesting of lists and objects, and of XML elements."""
_STRING = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+"?', re.S)
"""String of a JSON text. It never backtracks, which would take a hundred bytes of memory for each escape."""
_ARCHIVE = b"PK\3\4"
_HEADER = 10_000
"""Maximum size of a NumPy array header in bytes."""

_NO_ARRAYS = "not an archive of arrays, or damaged"

Kind = Callable[[str], SplatreelError]
"""Constructor of the error for a message: a class, or a function that adds a remedy."""


def read_file(path: Path, most: int, kind: Kind) -> bytes:
    """Return the bytes of a regular file.

    Raises:
        SplatreelError: Of the given kind, for a pipe, a device or a folder, for more than `most` bytes, or if reading
            fails.
    """
    with naming_damage(str(path), kind), open_regular(path, kind) as file:
        size = os.fstat(file.fileno()).st_size
        data = file.read(size + 1) if size <= most else b""
        while size < len(data) <= most and (more := file.read(min(_BLOCK, most + 1 - len(data)))):
            data += more  # the file grew, or states no size
    if size > most or len(data) > most:
        raise kind(f"{path}: has {max(size, len(data)):,} bytes, more than the {most:,} that it may have.")
    return data


def read_json(path: Path, kind: Kind, most: int = JSON_BYTES, values: int = JSON_VALUES) -> Any:
    """Return the JSON value in a file. Raises as `read_file` and `parse_json` do."""
    return parse_json(read_file(path, most, kind), kind, f"{path}:", values)


def parse_json(
    text: bytes | str, kind: Kind, subject: str, values: int = JSON_VALUES, number: Callable[[str], Any] | None = None
) -> Any:
    """Return the value of a JSON text.

    Args:
        text: JSON text.
        kind: Error constructor.
        subject: Start of the error message.
        values: Maximum number of values.
        number: Function that returns the value of a number's text, or raises `ValueError`; None uses Python's types and
            accepts NaN and infinity.

    Raises:
        SplatreelError: Of the given kind, for invalid JSON, too deep nesting, too many values, or an unpaired
            surrogate, which cannot be printed or written.
    """
    data = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    _check_size(data, kind, subject, values)
    try:
        value = json.loads(data.decode("utf-8"), parse_float=number, parse_int=number, parse_constant=number)
        if b"\\u" in data:
            json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        raise kind(f"{subject} holds half a character (\\u{ord(error.object[error.start]):04x}).".strip()) from error
    except (ValueError, RecursionError) as error:
        raise kind(f"{subject} is not JSON ({error}).".strip()) from error
    return value


def _check_size(data: bytes, kind: Kind, subject: str, most: int) -> None:
    """Check the number of values and the nesting without building objects."""
    depth, values, deepest = 0, 0, 0
    bare = _STRING.sub(b"", data)
    for start in range(0, len(bare), _BLOCK):
        block = np.frombuffer(bare[start : start + _BLOCK], np.uint8)
        opened = (block == ord("[")) | (block == ord("{"))
        steps = opened.astype(np.int32) - ((block == ord("]")) | (block == ord("}")))
        depths = depth + np.cumsum(steps)
        depth, deepest = int(depths[-1]), max(deepest, int(depths.max()))
        values += int(opened.sum()) + int((block == ord(",")).sum())
        if deepest > JSON_DEPTH:
            raise kind(f"{subject} is nested more than {JSON_DEPTH} deep.".strip())
        if values > most:
            raise kind(f"{subject} holds more than {most:,} values.".strip())


def parse_xml(text: str, kind: Kind, subject: str) -> ElementTree.Element:
    """Return the root of an XML text. Entities are refused, because they can expand without limit.

    Args:
        text: XML text. It is not decoded again, whatever encoding it declares.
        kind: Error constructor.
        subject: Start of the error message.

    Raises:
        SplatreelError: Of the given kind, for invalid XML, a document type, too deep nesting or too many elements.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise kind(f"{subject} declares a document type, which is not read.")
    try:
        return ElementTree.fromstring(text, parser=ElementTree.XMLParser(target=_BoundedTree()))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise kind(f"{subject} is not a complete XML file ({error}).") from error


class _BoundedTree(ElementTree.TreeBuilder):
    """Builder of XML trees of limited depth and size. Destroying a very deep tree overflows the stack."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = self._count = 0

    def start(self, tag: Any, attrs: Any, /) -> Any:
        self._depth, self._count = self._depth + 1, self._count + 1
        if self._depth > JSON_DEPTH:
            raise ValueError(f"nested more than {JSON_DEPTH} deep")
        if self._count > JSON_VALUES:
            raise ValueError(f"more than {JSON_VALUES:,} elements")
        return super().start(tag, attrs)

    def end(self, tag: Any, /) -> Any:
        self._depth -= 1
        return super().end(tag)


def read_array(path: Path, kind: Kind) -> np.ndarray:
    """Return the numeric array in a .npy file. Raises as `read_arrays` does."""
    with naming_damage(str(path), kind), open_regular(path, kind) as file:
        return _array(file, os.fstat(file.fileno()).st_size, f"{path}:", kind)


def read_arrays(path: Path, names: Iterable[str], kind: Kind, most: int | None = None) -> dict[str, np.ndarray]:
    """Return numeric arrays from a .npz file.

    Args:
        path: Archive.
        names: Names of the arrays.
        kind: Error constructor.
        most: Maximum unpacked size in bytes; None limits it in proportion to the file.

    Raises:
        SplatreelError: Of the given kind, for a damaged or encrypted archive, a missing name, an unpacked size above
            the limit, or an array of anything but plain numbers.
    """
    with naming_damage(str(path), kind, _NO_ARRAYS), open_regular(path, kind) as file, zipfile.ZipFile(file) as archive:
        size = os.fstat(file.fileno()).st_size
        members = {info.filename: info for info in archive.infolist()}
        wanted = {name: members.get(f"{name}.npy") for name in names}
        missing = next((name for name, info in wanted.items() if info is None), None)
        if missing is not None:
            raise kind(f"{path}: has no {missing}.")
        found = {name: info for name, info in wanted.items() if info is not None}
        unpacked, limit = sum(info.file_size for info in found.values()), most or allowed_memory(size)
        if unpacked > limit:
            raise kind(
                f"{path}: would unpack {size:,} bytes to {unpacked:,}, more than the {limit:,} that it may. If you trust it, allow "
                f"more: --max-memory {in_megabytes(unpacked)}."
            )
        arrays = {}
        for name, info in found.items():
            check_array_member(info, f"{path}: {name}", kind)
            with archive.open(info) as member:
                arrays[name] = _array(member, info.file_size, f"{path}: {name}", kind)
        return arrays


def load_arrays(data: bytes | io.BytesIO) -> Any:
    """Return the dictionaries, lists, strings, numbers and arrays in a pickle.

    Raises:
        pickle.UnpicklingError: The pickle names anything else, or is damaged.
    """
    return _ArrayUnpickler(io.BytesIO(data) if isinstance(data, bytes) else data, encoding="latin1").load()


class _ArrayUnpickler(pickle.Unpickler):
    """Unpickler that builds NumPy arrays and nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        if module in ("numpy.core.multiarray", "numpy._core.multiarray") and name in ("_reconstruct", "scalar"):
            return (np.zeros(0) if name == "_reconstruct" else np.float64(0)).__reduce__()[0]
        if (module, name) in (("numpy", "ndarray"), ("numpy", "dtype")):
            return getattr(np, name)
        if (module, name) == ("_codecs", "encode"):  # bytes in the second protocol of pickle
            return lambda text, _: text.encode("latin1")
        raise pickle.UnpicklingError(f"the pickle asks for {module}.{name}")


class ArrayRows:
    """Rows of a numeric array in a .npz file. One row is in memory at a time.

    Raises:
        SplatreelError: Of the given kind, as `read_arrays`.
    """

    def __init__(self, path: Path, name: str, kind: Kind) -> None:
        self._subject = f"{path}: {name}"
        self._kind = kind
        check_regular(path, kind)
        with naming_damage(str(path), kind, _NO_ARRAYS):
            self._archive = zipfile.ZipFile(path)
            if f"{name}.npy" not in self._archive.namelist():
                raise kind(f"{path}: has no {name}.")
            info = self._archive.getinfo(f"{name}.npy")
            check_array_member(info, self._subject, kind)
            self._member = self._archive.open(info)
            self.shape, in_columns, self.dtype = _header(self._member, info.file_size, self._subject, kind)
            self._start = self._member.tell()
        if in_columns and len(self.shape) > 1:
            raise kind(f"{self._subject} is stored column by column. Save it with numpy.ascontiguousarray.")

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, row: int) -> np.ndarray:
        size = math.prod(self.shape[1:]) * self.dtype.itemsize
        with naming_damage(self._subject, self._kind):
            self._member.seek(self._start + row * size)
            data = self._member.read(size)
        if len(data) < size:
            raise self._kind(f"{self._subject} ends within row {row}. Copy it again.")
        return np.frombuffer(data, self.dtype).reshape(self.shape[1:])


def _array(file: IO[bytes], size: int, subject: str, kind: Kind) -> np.ndarray:
    """Return the array at the current position of a file with `size` remaining bytes."""
    shape, in_columns, dtype = _header(file, size, subject, kind)
    needed = math.prod(shape) * dtype.itemsize
    if not needed:
        return np.zeros(shape, dtype)
    data = file.read(needed)
    if len(data) < needed:
        raise kind(f"{subject} ends after {len(data):,} of {needed:,} bytes. Copy it again.")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if in_columns else "C")


def _header(file: IO[bytes], size: int, subject: str, kind: Kind) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Return shape, column order and type of the array at the current position of a file with `size` remaining bytes."""
    try:
        magic = file.read(np.lib.format.MAGIC_LEN)
        if magic[:4] == _ARCHIVE:
            raise kind(f"{subject} is an archive of several arrays, expected a single one.")
        version = np.lib.format.read_magic(io.BytesIO(magic))
        if version == (1, 0):
            shape, in_columns, dtype = np.lib.format.read_array_header_1_0(file, _HEADER)
        elif version == (2, 0):
            shape, in_columns, dtype = np.lib.format.read_array_header_2_0(file, _HEADER)
        else:
            raise ValueError(f"format {version}")
    except (ValueError, SyntaxError, TokenError, TypeError, RecursionError, MemoryError, OverflowError) as error:
        raise kind(f"{subject} is not a NumPy array of plain numbers, or damaged. Copy it again.") from error
    if dtype.kind not in "fiu" or dtype.subdtype is not None or dtype.itemsize > 8:
        raise kind(f"{subject} is of {dtype}, expected an array of plain numbers. Convert it.")
    needed = math.prod(shape) * dtype.itemsize
    if min(shape, default=1) < 0 or needed > size:
        raise kind(f"{subject} ends early: {shape} of {dtype} need {needed:,} bytes. Copy it again.")
    return shape, in_columns, dtype


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a JSON value is a finite number: not a boolean, a string or an integer beyond the float range."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e300 < value < 1e300


def numbers(value: object, *shape: int) -> np.ndarray:
    """Return nested lists of finite numbers as float64.

    Raises:
        ValueError: A value is not a finite number, or the shape differs.
    """

    def check(part: object, left: tuple[int, ...]) -> None:
        if not left:
            if not is_number(part):
                raise ValueError(f"{part!r:.40} is not a finite number")
        elif not isinstance(part, list) or len(part) != left[0]:
            raise ValueError(f"{part!r:.40} is not a list of {left[0]}")
        else:
            for one in part:
                check(one, left[1:])

    check(value, shape)
    return np.array(value, np.float64).reshape(shape)


def check_regular(path: Path, kind: Kind) -> None:
    """Raise an error of the given kind for a pipe, a device or a folder, before a library opens the file by its name."""
    if path.exists() and not path.is_file():
        raise kind(_irregular(path))


def open_regular(path: Path, kind: Kind) -> io.BufferedReader:
    """Open a regular file without blocking on a pipe.

    Raises:
        SplatreelError: Of the given kind, for a pipe, a device or a folder.
        OSError: The file cannot be opened.
    """
    try:
        file = open(path, "rb", opener=_without_waiting)  # noqa: SIM115 - returned
    except IsADirectoryError as error:
        raise kind(_irregular(path)) from error
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise kind(_irregular(path))
    return file


def _irregular(path: Path) -> str:
    found = "a folder" if path.is_dir() else "a pipe or a device"
    return f"{path}: is {found}, expected a file. Remove or replace it."


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
