"""Settings in `run.json` and `oracle.json` files that an earlier version wrote, so that its runs can be continued."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from splatreel.config.config import Config
from splatreel.config.settings import changed, settings

ADDED_SETTINGS: dict[str, Any] = {
    "layering.enabled": True,
    "region": "",
    "keyframe.detail": False,
}
"""Settings added since 0.1.0, by name, with the value that changes nothing. A file without such a setting gets this value."""
FORMER_DEFAULTS: dict[str, Any] = {
    "keyframe.first_iterations": 2000,
    "keyframe.coarse_share": 0.5,
    "keyframe.detail": False,
}
"""Defaults of 0.1.0 that have changed, by name. A run that began with them continues with them."""


def complete_settings(recorded: Any, added: Mapping[str, Any] = ADDED_SETTINGS) -> dict[str, Any]:
    """Return recorded settings, nested as `Config.to_json` writes them, with those that their version did not have yet.

    Args:
        recorded: The settings of a file; anything but a dictionary has none.
        added: Values of missing settings, by name, such as `group.lambda_arap`.
    """
    found = _copy(recorded) if isinstance(recorded, dict) else {}
    for name, value in added.items():
        *sections, last = name.split(".")
        place = found
        for section in sections:
            place = place.setdefault(section, {})
            if not isinstance(place, dict):
                break
        else:
            place.setdefault(last, value)
    return found


def with_former_defaults(config: Config, recorded: Any) -> Config:
    """Return the settings with which a run continues: those asked for, and defaults of the version that began the run.

    A setting keeps its former default if the run has this value and the settings asked for have the present default.

    Args:
        config: Settings asked for.
        recorded: Settings of the run's file, see `complete_settings`; None without a run.
    """
    if not isinstance(recorded, dict):
        return config
    values, usual = complete_settings(recorded), Config()
    known = {name: setting.of(config) for name, setting in settings().items() if name in FORMER_DEFAULTS}
    kept = {name: FORMER_DEFAULTS[name] for name, value in known.items() if value == settings()[name].of(usual)}
    return changed(config, {name: value for name, value in kept.items() if _value(values, name) == value})


def _value(values: dict[str, Any], name: str) -> Any:
    """Return a nested value by its name, such as `keyframe.detail`; None if there is none."""
    section, _, last = name.rpartition(".")
    inner = values.get(section) if section else values
    return inner.get(last) if isinstance(inner, dict) else None


def _copy(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _copy(value) if isinstance(value, dict) else value for name, value in settings.items()}
