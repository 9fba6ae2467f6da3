"""A section, one named part of a layer or group file: its bytes, and the parameters that say how they are decoded."""

from __future__ import annotations

from dataclasses import dataclass

from splatreel.codec.quantize import Parameters
from splatreel.errors import ReelError

MAX_POINTS = 1 << 23
"""Points of one file."""


@dataclass(frozen=True)
class Section:
    """One named part of a file: its bytes, and what the header says about how to decode them."""

    data: bytes
    parameters: Parameters


Sections = dict[str, Section]


def required(sections: Sections, name: str) -> Section:
    """The section of that name. Raises `ReelError` where there is none."""
    if name not in sections:
        raise ReelError(f"has no section {name!r}.")
    return sections[name]


def section_of(sections: Sections, name: str, codec: str) -> Section:
    """The section of that name and codec. Raises `ReelError`."""
    section = required(sections, name)
    found = section.parameters.get("codec")
    if found != codec:
        raise ReelError(f"section {name!r} has the unknown codec {found!r:.60}, expected {codec!r}.")
    return section


def named(name, function, *arguments):
    """Call function; a `ReelError` of it gets the section's name."""
    try:
        return function(*arguments)
    except ReelError as error:
        raise ReelError(f"section {name!r} {error}") from error
