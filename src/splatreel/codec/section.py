"""Sections: the named parts of a layer or group file."""

from __future__ import annotations

from dataclasses import dataclass

from splatreel.base.errors import ReelError
from splatreel.codec.quantize import Parameters

MAX_POINTS = 1 << 23
"""Maximum number of points in one file."""


@dataclass(frozen=True)
class Section:
    """Bytes of a section, and the parameters from the header that describe its coding."""

    data: bytes
    parameters: Parameters


Sections = dict[str, Section]


def required(sections: Sections, name: str) -> Section:
    """Return the section of a given name. Raise `ReelError` if it is missing."""
    if name not in sections:
        raise ReelError(f"has no section {name!r}.")
    return sections[name]


def section_of(sections: Sections, name: str, codec: str) -> Section:
    """Return the section of a given name and codec. Raise `ReelError` if it is missing or has another codec."""
    section = required(sections, name)
    found = section.parameters.get("codec")
    if found != codec:
        raise ReelError(f"section {name!r} has the unknown codec {found!r:.60}, expected {codec!r}.")
    return section


def named(name, function, *arguments):
    """Call a function and prefix its `ReelError` with the section's name."""
    try:
        return function(*arguments)
    except ReelError as error:
        raise ReelError(f"section {name!r} {error}") from error
