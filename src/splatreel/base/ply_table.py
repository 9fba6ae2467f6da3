"""Reader of PLY files: text or binary, either byte order, elements in any order, lines that end as on any system."""

from __future__ import annotations

import os
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, points_memory
from splatreel.base.untrusted import naming_damage, open_regular

_MAX_HEADER = 1 << 17
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_NAN = re.compile(rb"[+-]?nan\(\w*\)|[+-]?1\.#(?:IND|QNAN)\w*", re.I)
"""NaN as C runtimes write it. Parentheses hold word characters only, so that a search takes linear time."""

Columns = dict[str, np.ndarray]
"""Columns of an element by property name, [count] each."""


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[tuple[str, str], ...]
    lists: tuple[tuple[str, str] | None, ...]
    """Types of the length and of the items of each property that is a list."""

    def record(self, order: str) -> np.dtype:
        return np.dtype([(name, order + kind) for name, kind in self.properties])


def read_elements(path: str | Path, wanted: tuple[str, ...], budget: MemoryBudget = UNRAISED) -> dict[str, Columns]:
    """Return the wanted elements of a PLY file. Elements that the file lacks are left out.

    Args:
        path: Input file.
        wanted: Names of elements.
        budget: Memory that reading may take.

    Raises:
        GaussiansError: The file is not a PLY file, is damaged, takes too much memory, or a wanted element holds lists.
    """
    path = Path(path)
    with naming_damage(str(path), GaussiansError), open_regular(path, GaussiansError) as file:
        order, elements, start = _parse_header(file.read(_MAX_HEADER), path)
        last = max((i for i, element in enumerate(elements) if element.name in wanted), default=-1)
        if last < 0:
            return {}
        _check_memory([element for element in elements if element.name in wanted], file, path, budget)
        file.seek(start)
        body = file.read()
    split = _split_lines if order == "ascii" else _split_bytes
    return split(body, elements[: last + 1], wanted, _ORDERS[order], path)


def read_comments(path: Path) -> list[str]:
    """Return the comments of a PLY file's header, without the word "comment".

    Raises:
        GaussiansError: The file cannot be read.
    """
    with naming_damage(str(path), GaussiansError), open_regular(path, GaussiansError) as file:
        head = file.read(_MAX_HEADER)
    end = re.search(rb"[\r\n]end_header", head)
    lines = head[: end.start() if end else 0].decode("latin-1").splitlines()
    return [line[len("comment") :].strip() for line in lines if re.match(r"comment\s", line)]


def _check_memory(elements: list[_Element], file: IO[bytes], path: Path, budget: MemoryBudget) -> None:
    """Raise `GaussiansError` if the points that the file can hold take too much memory."""
    size = os.fstat(file.fileno()).st_size
    points = max((min(element.count, size // max(len(element.properties), 1)) for element in elements), default=0)
    coefficients = sum(name.startswith("f_rest_") for element in elements for name, _ in element.properties)
    budget.check(size + points_memory(points, coefficients), size, str(path), f"{points:,} points")


def _parse_header(head: bytes, path: Path) -> tuple[str, list[_Element], int]:
    """Return the format, the elements, and the offset of the first one."""
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", head)
    end = re.search(rb"[\r\n]end_header[ \t]*", head)
    if first is None or end is None:
        raise GaussiansError(f"{path}: is not a PLY file.")
    line_end = first[1]
    if head[end.end() : end.end() + len(line_end)] != line_end:
        raise GaussiansError(
            f"{path}: the lines of its header end in different ways, so the start of its data is unclear."
        )
    order, elements = "", []
    for line in head[: end.start()].decode("latin-1").split(line_end.decode()):
        words = line.split()
        if words[:1] == ["format"]:
            order = words[1] if len(words) == 3 and words[2] == "1.0" else line
        elif words[:1] == ["element"] and len(words) == 3:
            elements.append(_Element(words[1], _count(words[2], path), (), ()))
        elif words[:1] == ["property"] and elements:
            elements[-1] = _with_property(elements[-1], words[1:], path)
    if order not in _ORDERS:
        raise GaussiansError(f"{path}: is not a PLY file of a known format ({order!r:.40}).")
    return order, elements, end.end() + len(line_end)


def _with_property(element: _Element, words: list[str], path: Path) -> _Element:
    is_list = words[:1] == ["list"]
    kinds = words[1:-1] if is_list else words[:-1]
    if len(words) != (4 if is_list else 2) or not all(kind in _TYPES for kind in kinds):
        raise GaussiansError(f"{path}: has the property {' '.join(words)!r:.100}, expected a number or a list.")
    name = words[-1]
    if any(name == other for other, _ in element.properties):
        raise GaussiansError(f"{path}: names the property {name!r:.40} twice.")
    if is_list and _TYPES[kinds[0]][0] == "f":
        raise GaussiansError(
            f"{path}: the lengths of its list {name!r:.40} are of type {kinds[0]}, expected an integer type. Export it again."
        )
    listed = (_TYPES[kinds[0]], _TYPES[kinds[1]]) if is_list else None
    return _Element(
        element.name,
        element.count,
        (*element.properties, (name, _TYPES[kinds[-1]])),
        (*element.lists, listed),
    )


def _count(word: str, path: Path) -> int:
    if not word.isdecimal() or len(word) > 10:
        raise GaussiansError(f"{path}: claims to hold {word!r:.40} points.")
    return int(word)


def _check_plain(element: _Element, path: Path) -> None:
    if element.count and not element.properties:
        raise GaussiansError(f"{path}: its element {element.name} has no properties. Export it again.")
    if any(element.lists):
        raise GaussiansError(
            f"{path}: its element {element.name} has a property that is a list, expected plain numbers."
        )


def _split_bytes(
    body: bytes, elements: list[_Element], wanted: tuple[str, ...], order: str, path: Path
) -> dict[str, Columns]:
    found: dict[str, Columns] = {}
    at = 0
    for element in elements:
        if any(element.lists) and element.name not in wanted:
            at = _skip_lists(body, at, element, order, path)
            continue
        _check_plain(element, path)
        record = element.record(order)
        size = element.count * record.itemsize
        if len(body) - at < size:
            raise GaussiansError(
                f"{path}: ends after {max(len(body) - at, 0)} of {size} bytes of its element {element.name}. Copy it again."
            )
        if element.name in wanted:
            table = np.frombuffer(body, record, element.count, at)
            found[element.name] = {name: table[name] for name in record.names or ()}
        at += size
    return found


def _skip_lists(body: bytes, at: int, element: _Element, order: str, path: Path) -> int:
    """Return the offset after an element whose rows have different lengths."""
    kinds = [
        (np.dtype(order + kind), listed) for (_, kind), listed in zip(element.properties, element.lists, strict=True)
    ]
    for row in range(element.count):
        for kind, listed in kinds:
            size = kind.itemsize
            if listed is not None:
                length = np.dtype(order + listed[0])
                if at + length.itemsize > len(body):
                    raise GaussiansError(f"{path}: ends within its element {element.name}. Copy it again.")
                items = int(np.frombuffer(body, length, 1, at)[0])
                if items < 0:
                    raise GaussiansError(
                        f"{path}: row {row} of its element {element.name} (counted from 0) claims a list of {items} items. "
                        "Export it again."
                    )
                size = length.itemsize + items * kind.itemsize
            at += size
        if at > len(body):
            raise GaussiansError(f"{path}: ends within its element {element.name}. Copy it again.")
    return at


def _split_lines(
    body: bytes, elements: list[_Element], wanted: tuple[str, ...], order: str, path: Path
) -> dict[str, Columns]:
    """Return the columns of elements written as text, a line for each row."""
    lines = [line for line in body.splitlines() if line.strip()]
    found: dict[str, Columns] = {}
    at = 0
    for element in elements:
        if len(lines) - at < element.count:
            raise GaussiansError(
                f"{path}: ends after {len(lines) - at} of {element.count} lines of its element {element.name}. Copy it again."
            )
        if element.name in wanted:
            _check_plain(element, path)
            found[element.name] = _parse_lines(lines[at : at + element.count], element, path)
        at += element.count
    return found


def _parse_lines(lines: list[bytes], element: _Element, path: Path) -> Columns:
    width = len(element.properties)
    odd = next((row for row, line in enumerate(lines) if len(line.split()) != width), None)
    numbers = np.zeros(0) if odd is not None else _numbers(b" ".join(lines))
    if len(numbers) != element.count * width:
        row = odd if odd is not None else next((i for i, line in enumerate(lines) if len(_numbers(line)) != width), 0)
        raise GaussiansError(
            f"{path}: row {row} of its element {element.name} (counted from 0) is {lines[row].decode('latin-1')!r:.80}, "
            f"expected {width} numbers."
        )
    table = numbers.reshape(element.count, width)
    return {name: _as_kind(table[:, i], kind) for i, (name, kind) in enumerate(element.properties)}


def _numbers(text: bytes) -> np.ndarray:
    """Return the numbers of a text, float64, or nothing if a word is none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # how older versions of numpy report other words
            return np.fromstring(_NAN.sub(b"nan", text).decode("latin-1"), np.float64, sep=" ") if text else np.zeros(0)
    except (ValueError, DeprecationWarning):
        return np.zeros(0)


def _as_kind(column: np.ndarray, kind: str) -> np.ndarray:
    """Return a column with the type of its property, which says how colors are scaled."""
    if kind[0] == "f":
        return column
    limits = np.iinfo(kind)
    return np.clip(np.nan_to_num(column), limits.min, limits.max).astype(kind)
