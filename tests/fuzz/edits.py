"""Interpretation of a byte string as edits to a seed. So every input of a fuzzer is almost a valid file and passes the first checks.

The first byte chooses the seed. Each edit then reads one byte for its kind, and its arguments. Edits change headers, section lengths,
section bytes, zlib streams and the whole file, or take a section from another seed.
"""

from __future__ import annotations

import contextlib
import copy
import json
import struct
import zlib
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from splatreel.codec.container import unpack_file
from tests.fuzz.seeds import DOCUMENTS, files

VALUES: list[Any] = [
    0, 1, -1, 2, 255, 1 << 16, 1 << 26, 1 << 31, 1 << 40, 1 << 64, -(1 << 63), 10**400, 0.5, -0.5, 1e-300, 1e308, float("nan"),
    float("inf"), None, True, False, "", "x", "../x", "/etc/x", "//host/x", "http://host/x", "h265", "lattice", "klt", "float32",
    "picture", [], [0], [float("nan")] * 3, {}, {"codec": "klt"}, [[0] * 3] * 2, "a" * 5000, [0] * 300,
]  # fmt: skip
MAX_EDITS = 12


class Program:
    """Reader of a byte string. Past the end, every number is 0."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    @property
    def left(self) -> bool:
        return self.at < len(self.data)

    def number(self, size: int = 1) -> int:
        value = int.from_bytes(self.data[self.at : self.at + size], "little")
        self.at += size
        return value

    def below(self, count: int) -> int:
        """Return a number in 0..count - 1. count: at least 1."""
        return self.number(1 if count <= 256 else 4) % count


@dataclass
class Draft:
    """The parts of a file. own: the metadata. places: header entries of sections that replace the true ones."""

    own: dict[str, Any]
    sections: dict[str, bytes]
    places: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, data: bytes) -> Draft:
        own, sections = _parts(data)
        return cls(json.loads(own), dict(sections))

    def pack(self) -> bytes:
        header: dict[str, Any] = {"__metadata__": {"splatreel": json.dumps(self.own)}}
        at = 0
        for name, data in self.sections.items():
            header[name] = {
                "dtype": "U8",
                "shape": [len(data)],
                "data_offsets": [at, at + len(data)],
            } | self.places.get(name, {})
            at += len(data)
        text = json.dumps(header).encode()
        return struct.pack("<Q", len(text)) + text + b"".join(self.sections.values())


@cache
def _parts(data: bytes) -> tuple[str, dict[str, bytes]]:
    """Return the metadata as text and the sections of a file. The cache matters: a fuzzer asks thousands of times per second."""
    size = int.from_bytes(data[:8], "little")
    own = json.loads(data[8 : 8 + size])["__metadata__"]["splatreel"]
    return own, {name: section.data for name, section in unpack_file(data)[1].items()}


def run(data: bytes) -> tuple[str, bytes]:
    """Run a program: return the name of the seed and the edited file."""
    program = Program(data)
    names = sorted(files())
    name = names[program.below(len(names))]
    if name in DOCUMENTS:
        document = json.loads(files()[name])
        for _ in range(MAX_EDITS):
            if program.left:
                edit_json(document, program)
        return name, damaged(json.dumps(document).encode(), program)
    if name == "sound":
        data = files()[name]
        for _ in range(MAX_EDITS):
            data = damaged(data, program)
        return name, data
    draft = Draft.of(files()[name])
    for _ in range(MAX_EDITS):
        if program.left:
            edit(draft, program)
    return name, damaged(draft.pack(), program)


def edit(draft: Draft, program: Program) -> None:
    kind = program.number() % 8
    if kind < 3 or not draft.sections:
        return edit_json(draft.own, program)
    name = sorted(draft.sections)[program.below(len(draft.sections))]
    if kind < 5:
        draft.sections[name] = damaged(draft.sections[name], program, always=True)
    elif kind == 5:
        with contextlib.suppress(zlib.error):
            draft.sections[name] = zlib.compress(damaged(zlib.decompress(draft.sections[name]), program, always=True))
    elif kind == 6:
        names = sorted(set(files()) - {*DOCUMENTS, "sound"})
        other = Draft.of(files()[names[program.below(len(names))]])
        taken = sorted(other.sections)[program.below(len(other.sections))]
        draft.sections[taken] = other.sections[taken]
        if isinstance(draft.own.get("sections"), dict):
            draft.own["sections"][taken] = other.own["sections"][taken]
    else:
        key = ("dtype", "shape", "data_offsets")[program.below(3)]
        draft.places[name] = {key: VALUES[program.below(len(VALUES))]}


def edit_json(document: dict[str, Any], program: Program) -> None:
    """Replace or remove a value somewhere in a document."""
    owner: Any = document
    while keys := list(owner if isinstance(owner, dict) else range(len(owner))):
        key = keys[program.below(len(keys))]
        if not (isinstance(owner[key], dict | list) and owner[key] and program.number() % 8):
            return _edit_value(owner, key, program)
        owner = owner[key]


def _edit_value(owner: Any, key: Any, program: Program) -> None:
    kind = program.number() % 4
    if kind == 0:
        del owner[key]
    elif kind == 1:
        owner[key] = program.number(2) - 100
    elif kind == 2 and isinstance(owner[key], int | float) and abs(owner[key]) < 1e9:
        owner[key] += program.number() - 128
    else:
        owner[key] = copy.deepcopy(VALUES[program.below(len(VALUES))])


def damaged(data: bytes, program: Program, always: bool = False) -> bytes:
    """Return data after one edit that changes, inserts, removes or cuts off bytes; unchanged if the program is at its end."""
    if not (always or program.left):
        return data
    kind = program.number() % 6
    at = program.below(len(data) + 1)
    if kind == 0:
        return data[:at] + bytes([(data[at] if at < len(data) else 0) ^ (program.number() or 1)]) + data[at + 1 :]
    if kind == 1:
        return data[:at]
    if kind == 2:
        return data[:at] + data[at + 1 + program.number() :]
    if kind == 3:
        return data[:at] + bytes([program.number()]) * (1 + program.number()) + data[at:]
    return data[:at] + struct.pack("<I" if kind == 4 else ">I", VALUES[program.below(12)] & 0xFFFFFFFF) + data[at + 4 :]
