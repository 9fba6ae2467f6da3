"""Parsing of JSON from untrusted files."""

from __future__ import annotations

import json
from typing import Any

from splatreel.errors import ReelError


def parse_object(text: bytes | str, what: str = "") -> dict[str, Any]:
    """The JSON object in text. what: which text of a file it is. Raises `ReelError` for all else, also for halves of characters:
    they could be neither printed nor written."""
    subject = f"has a {what} that" if what else ""
    try:
        text = text if isinstance(text, str) else text.decode("utf-8")
        value = json.loads(text)
        if "\\u" in text:
            json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        raise ReelError(
            f"{subject} holds half a character (\\u{ord(error.object[error.start]):04x}).".strip()
        ) from error
    except (ValueError, RecursionError) as error:
        raise ReelError(f"{subject} is not JSON ({error}).".strip()) from error
    if not isinstance(value, dict):
        raise ReelError(f"{subject} is not a JSON object.".strip())
    return value
