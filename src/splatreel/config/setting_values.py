"""Types, ranges and choices of settings, checked when a config is made and when a value is read from text."""

from __future__ import annotations

import math
import types
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from splatreel.base.errors import UsageError

E = TypeVar("E")


@dataclass(frozen=True)
class Range:
    """Numbers from low to high, both included. A high of None means no limit."""

    low: float
    high: float | None = None

    def holds(self, value: float) -> bool:
        """Return True if a number is in the range."""
        return self.low <= value and (self.high is None or value <= self.high)

    def __str__(self) -> str:
        """Return the range in words."""
        return f"{self.low} or more" if self.high is None else f"{self.low} to {self.high}"


def shown(value: Any) -> str:
    """Return a value in the form that --set takes."""
    if isinstance(value, tuple):
        return ",".join(value) or "none"
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


@dataclass(frozen=True)
class Needs:
    """Condition on another setting, without which a setting has no effect. It stands beside the setting's type.

    Attributes:
        name: Full name of the other setting. The other setting must have an effect itself.
        values: Values of the other setting with which the setting has an effect.
        but: All values except these, if there are no `values`.
        other: Condition that is enough, too.
        always: Values of the setting itself that have an effect in any case.
    """

    name: str
    values: tuple[Any, ...] = ()
    but: tuple[Any, ...] = ()
    other: Needs | None = None
    always: tuple[Any, ...] = ()

    def holds(self, value: Any) -> bool:
        """Return True if the setting has an effect with a value of the other setting."""
        return value in self.values if self.values else value not in self.but

    def __str__(self) -> str:
        """Return the condition in words."""
        values = " or ".join(map(shown, self.values or self.but))
        own = f"{self.name}{'=' if self.values else ' other than '}{values}"
        return own if self.other is None else f"{own} or {self.other}"


@dataclass(frozen=True)
class Paper:
    """Hyper-parameter of the paper that a setting has. It stands beside the setting's type, and the preset paper has its value.

    Attributes:
        name: Name or meaning of the hyper-parameter.
        exceptions: Other values of the paper, such as "MeetRoom 20".
        standard: Explanation of the default.
    """

    name: str
    exceptions: str = ""
    standard: str = ""


class Chosen:
    """Measurements by which a default was chosen. They stand beside the setting's type; a setting without them was not measured.

    Attributes:
        captures: Captures that were compared.
        measured: Addresses of the measurements, relative to docs/.
        seeds: Seeds of the runs.
    """

    def __init__(self, captures: str, *measured: str, seeds: str = "0") -> None:
        """Store the captures, the addresses and the seeds."""
        self.captures, self.measured, self.seeds = captures, measured, seeds


Count = Annotated[int, Range(1)]
Share = Annotated[float, Range(0, 1)]
Weight = Annotated[float, Range(0)]
"""Weight of a loss, or a threshold; 0 turns it off."""
Bits = Annotated[int, Range(1, 16)]
Crf = Annotated[int, Range(0, 51)]


@dataclass(frozen=True)
class Kind:
    """Type of a setting.

    Attributes:
        base: Python type of a single value.
        limits: Range of a number, if it has one.
        choices: All possible texts, if there are only some.
        several: True for a tuple of choices.
        optional: True if the value may be None.
    """

    base: type
    limits: Range | None = None
    choices: tuple[str, ...] = ()
    several: bool = False
    optional: bool = False

    def __str__(self) -> str:
        """Return in words what may be written."""
        if self.choices:
            text = f"{'some' if self.several else 'one'} of {', '.join(self.choices)}"
        elif self.base is bool:
            text = "true or false"
        else:
            text = {int: "a whole number", str: "a text"}.get(self.base, "a number")
            text += f" from {self.limits}" if self.limits and self.limits.high is not None else ""
            text += f", {self.limits}" if self.limits and self.limits.high is None else ""
        return f"{text}, or none" if self.optional or self.several else text

    def check(self, name: str, value: Any) -> None:
        """Check a value.

        Raises:
            UsageError: The value is out of range, or not one of the choices.
        """
        if self.optional and value is None:
            return
        if self.limits is not None and not self.limits.holds(value):
            raise UsageError(f"{name} {value} is out of range. Choose {self.limits}.")
        wrong = [v for v in (value if self.several else (value,)) if self.choices and v not in self.choices]
        if wrong:
            raise UsageError(f"{name} {wrong[0]!r} is unknown. Choose {self}.")

    def parse(self, name: str, text: str) -> Any:
        """Return the value that a text stands for.

        Raises:
            UsageError: The text is not such a value.
        """
        text = text.strip()
        if text.lower() == "none" and (self.optional or self.several):
            return () if self.several else None
        if self.several:
            return tuple(part.strip() for part in text.split(",") if part.strip())
        read = {bool: _truth, int: _whole, float: _real, str: str}[self.base]
        value = read(text)
        if value is None:
            raise UsageError(f"{name} {text!r:.60} is not {self}.")
        return value


def _truth(text: str) -> bool | None:
    return {"true": True, "1": True, "false": False, "0": False}.get(text.lower())


def _whole(text: str) -> int | None:
    try:
        return int(text)
    except ValueError:
        return None


def _real(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def kind_of(hint: Any) -> Kind:
    """Return the kind of a field by its annotation."""
    if get_origin(hint) is Annotated:
        limits = [extra for extra in get_args(hint)[1:] if isinstance(extra, Range)]
        return replace(kind_of(get_args(hint)[0]), limits=limits[0]) if limits else kind_of(get_args(hint)[0])
    if get_origin(hint) is Literal:
        return Kind(str, choices=get_args(hint))
    if get_origin(hint) is tuple:
        return Kind(str, choices=get_args(get_args(hint)[0]), several=True)
    if get_origin(hint) in (Union, types.UnionType):
        inner = kind_of(next(part for part in get_args(hint) if part is not type(None)))
        return Kind(inner.base, inner.limits, inner.choices, inner.several, optional=True)
    return Kind(hint)


def extras_of(hint: Any, kind: type[E]) -> tuple[E, ...]:
    """Return what the annotation of a field or section has of a kind, such as its conditions (`Needs`)."""
    return tuple(extra for extra in get_args(hint)[1:] if isinstance(extra, kind))


@cache
def kinds(section: type) -> dict[str, Kind]:
    """Return the kinds of a section's own settings by name, without those of sections in it."""
    hints, plain = get_type_hints(section, include_extras=True), get_type_hints(section)
    return {field.name: kind_of(hints[field.name]) for field in fields(section) if not is_dataclass(plain[field.name])}


def check(section: Any, prefix: str) -> None:
    """Check all settings of a section. `prefix` is put before their names, such as `group.`.

    Raises:
        UsageError: A value is out of range, or not one of the choices.
    """
    for name, kind in kinds(type(section)).items():
        kind.check(prefix + name, getattr(section, name))
