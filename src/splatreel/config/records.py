"""Settings in `run.json` and `oracle.json` files that an earlier version wrote, so that its runs can be continued."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

ADDED_SETTINGS: dict[str, Any] = {"layering.enabled": True, "region": ""}
"""Settings added since 0.1.0, by name, with the value that changes nothing. A file without such a setting gets this value."""


def complete_settings(recorded: Any, added: Mapping[str, Any] = ADDED_SETTINGS) -> dict[str, Any]:
    """Return recorded settings, nested as `Config.to_json` writes them, with those that their version did not have yet.

    Args:
        recorded: The settings of a file; anything but a dictionary has none.
        added: Values of missing settings, by name, such as `group.lambda_arap`.
    """
    settings = _copy(recorded) if isinstance(recorded, dict) else {}
    for name, value in added.items():
        *sections, last = name.split(".")
        place = settings
        for section in sections:
            place = place.setdefault(section, {})
            if not isinstance(place, dict):
                break
        else:
            place.setdefault(last, value)
    return settings


def _copy(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _copy(value) if isinstance(value, dict) else value for name, value in settings.items()}
