"""Settings by name, such as `group.lambda_arap`: their documentation, and configs with some of them changed.

Records of runs, `run.json` and `oracle.json`, hold settings of the version that wrote them.
"""

from __future__ import annotations

import ast
import copy
import dataclasses
import difflib
import functools
import inspect
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, TypeVar, cast, get_type_hints

from splatreel.base.errors import UsageError
from splatreel.config.config import Config
from splatreel.config.setting_values import Chosen, Kind, Needs, Paper, extras_of, kinds, shown

T = TypeVar("T")
NEAREST = 3
"""Number of names that an error suggests."""
LIKE = 0.7
"""Least similarity of suggested names, 0..1, as difflib measures it."""

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
REMOVED_SETTINGS: dict[str, Any] = {
    "group.lambda_dssim": 0.2,
    "layering.flow_threshold": 2.0,
    "layering.lambda_nn": 0.5,
    "layering.lambda_dyn": 0.3,
    "layering.adapt_gradient": 3e-4,
    "layering.adapt_neighbors": 0.6,
    "encode.h265.crf_rotation": None,
}
"""Settings of earlier versions, by name, with the value that they always have now. A file may have it."""


@dataclass(frozen=True)
class Setting:
    """A setting.

    Attributes:
        name: Full name, such as `group.lambda_arap`.
        kind: Type and range of its values.
        doc: Documentation.
        needs: Conditions on other settings, without which it has no effect.
        paper: Hyper-parameter of the paper that it has; None if there is none.
        chosen: Measurements by which its default was chosen; None without any.
    """

    name: str
    kind: Kind
    doc: str
    needs: tuple[Needs, ...] = ()
    paper: Paper | None = None
    chosen: Chosen | None = None

    @property
    def section(self) -> str:
        """Name of its section, such as `group`; empty for a general setting."""
        return self.name.rpartition(".")[0]

    def of(self, config: Config) -> Any:
        """Return the value that a config has."""
        return attrgetter(self.name)(config)

    def obstacle(self, config: Config) -> tuple[str, Needs] | None:
        """Return why the setting has no effect in a config; None if it has one.

        Returns:
            Another setting with its value, such as `encode.codec=predictive`, and the condition that it does not meet.
        """
        for need in self.needs:
            if self.of(config) not in need.always and (found := _unmet(need, config)) is not None:
                return found
        return None


def _unmet(need: Needs, config: Config) -> tuple[str, Needs] | None:
    """Return the obstacle of a condition, see `Setting.obstacle`; None if the condition or its alternative is met."""
    other = settings()[need.name]
    value = other.of(config)
    found = other.obstacle(config) if need.holds(value) else (f"{need.name}={shown(value)}", need)
    if found is None or need.other is None:
        return found
    second = _unmet(need.other, config)
    return None if second is None else (f"{found[0]} and {second[0]}", need)


@functools.cache
def settings() -> dict[str, Setting]:
    """Return all settings by name, in the order of the classes."""
    return {setting.name: setting for setting in _settings_of(Config, "")}


@functools.cache
def sections() -> dict[str, str]:
    """Return the purpose of each section by name, in the order of the classes. General settings have an empty section name."""
    return dict(_sections_in(Config, ""))


def _sections_in(section: type, name: str) -> Iterator[tuple[str, str]]:
    yield name, (section.__doc__ or "").partition("\n")[0]
    for field, hint in get_type_hints(section).items():
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            yield from _sections_in(hint, f"{name}.{field}".removeprefix("."))


def _settings_of(section: type, prefix: str, needs: tuple[Needs, ...] = ()) -> Iterator[Setting]:
    hints, own, docs = get_type_hints(section), kinds(section), _docs(section)
    extras = get_type_hints(section, include_extras=True)
    for field in dataclasses.fields(section):
        hint = extras[field.name]
        all_needs = needs + extras_of(hint, Needs)
        if field.name in own:
            paper, chosen = next(iter(extras_of(hint, Paper)), None), next(iter(extras_of(hint, Chosen)), None)
            yield Setting(prefix + field.name, own[field.name], docs[field.name], all_needs, paper, chosen)
        else:
            yield from _settings_of(hints[field.name], f"{prefix}{field.name}.", all_needs)


def without_effect(config: Config, names: Iterable[str]) -> dict[str, str]:
    """Return the settings of a list that have no effect in a config, by name, each with the end of a sentence about it."""
    obstacles = {name: settings()[name].obstacle(config) for name in names}
    return {
        name: f"has no effect with {found[0]}. It needs {found[1]}"
        for name, found in obstacles.items()
        if found is not None
    }


def _docs(section: type) -> dict[str, str]:
    """Return the string after each field of a class."""
    body = ast.parse(textwrap.dedent(inspect.getsource(section))).body[0]
    assert isinstance(body, ast.ClassDef)
    found, name = dict[str, str](), None
    for node in body.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            name = node.target.id
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and name is not None:
            found[name] = " ".join(str(node.value.value).split())
    return found


def changed(config: T, values: Mapping[str, Any]) -> T:
    """Return a config, or a section of one, with some values changed at once.

    Args:
        config: The config or section.
        values: New values by name.

    Raises:
        UsageError: A value is out of range.
    """
    own: dict[str, Any] = {}
    inner: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        section, dot, rest = name.partition(".")
        if dot:
            inner.setdefault(section, {})[rest] = value
        else:
            own[name] = value
    own |= {section: changed(getattr(config, section), some) for section, some in inner.items()}
    return dataclasses.replace(cast(Any, config), **own)


def parse_settings(texts: Iterable[str]) -> dict[str, Any]:
    """Return the values in texts such as `group.tracks=false`, by name.

    Raises:
        UsageError: There is no such setting, or it has no such value.
    """
    found = {}
    for text in texts:
        name, equals, value = text.partition("=")
        name = name.strip()
        if not equals:
            raise UsageError(f"{text!r:.60} has no value. Write NAME=VALUE, such as group.lambda_arap=0.")
        if name in REMOVED_SETTINGS:
            raise UsageError(
                f"{name} is not a setting any more: it is {shown(REMOVED_SETTINGS[name])} in every run. Leave it out."
            )
        if name not in settings():
            raise UsageError(f"{name!r:.60} is not a setting. {_suggestion(name)}`splatreel config` lists all.")
        if name in found:
            raise UsageError(f"{name} is set twice.")
        kind = settings()[name].kind
        found[name] = kind.parse(name, value)
        kind.check(name, found[name])
    return found


def _suggestion(name: str) -> str:
    """Return settings with the same name in another section, or with a similar name."""
    ends = {known: known.rpartition(".")[2] for known in settings()}
    near = [known for known, end in ends.items() if end == name]
    if not near:
        alike = difflib.get_close_matches(name.rpartition(".")[2], set(ends.values()), NEAREST, LIKE)
        near = [known for end in alike for known, its in ends.items() if its == end]
        near += difflib.get_close_matches(name, settings(), NEAREST, LIKE)
    return f"Did you mean {' or '.join(list(dict.fromkeys(near))[:NEAREST])}? " if near else ""


def complete_settings(recorded: Any, added: Mapping[str, Any] = ADDED_SETTINGS) -> dict[str, Any]:
    """Return recorded settings, nested as `Config.to_json` writes them, as this version has them.

    Those that their version did not have yet are added. Removed ones are left out if they have the value that is fixed now.

    Args:
        recorded: The settings of a file; anything but a dictionary has none.
        added: Values of missing settings, by name, such as `group.lambda_arap`.
    """
    found = copy.deepcopy(recorded) if isinstance(recorded, dict) else {}
    for name, value in REMOVED_SETTINGS.items():
        *sections, last = name.split(".")
        place = functools.reduce(
            lambda outer, section: outer.get(section) if isinstance(outer, dict) else None, sections, found
        )
        if isinstance(place, dict) and last in place and place[last] == value:
            del place[last]
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
