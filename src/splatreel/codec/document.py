"""JSON of reels: parsing of untrusted files, and output that people can read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from splatreel.base.errors import ReelError
from splatreel.base.untrusted import parse_json


def parse_object(text: bytes | str, what: str = "") -> dict[str, Any]:
    """Return the JSON object in a text.

    Args:
        text: JSON text.
        what: Part of the file, for messages.

    Raises:
        ReelError: The text is anything else, or contains unpaired surrogates, which cannot be printed or written.
    """
    subject = f"has a {what} that" if what else ""
    value = parse_json(text, ReelError, subject, number=_number)
    if not isinstance(value, dict):
        raise ReelError(f"{subject} is not a JSON object.".strip())
    return value


def _number(text: str) -> float:
    """Return the value of a number's text. Raise `ValueError` if it is not finite as a 64-bit floating-point number."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text:.12} is not a finite number")
    return int(text) if text.removeprefix("-").isdigit() else value


def items(document: Mapping[str, Any], name: str, low: int, high: int) -> list[Any]:
    """Return the list of a given name. Raise `ReelError` unless it has `low` to `high` items."""
    value = document.get(name)
    if not isinstance(value, list) or not low <= len(value) <= high:
        raise ReelError(f"has {name} that are not a list of {low} to {high} items.")
    return value


def in_lines(document: Mapping[str, Any]) -> str:
    """Return JSON with one line per field and per object of its lists: compact, but readable."""
    return "{\n" + ",\n".join(f"{json.dumps(name)}: {_lines(value)}" for name, value in document.items()) + "\n}\n"


def _lines(value: Any) -> str:
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "[\n" + ",\n".join(_lines(entry) for entry in value) + "\n]"
    return json.dumps(value, separators=(",", ":"), allow_nan=False)
