"""`splatreel config`."""

from __future__ import annotations

import json as json_format
import shutil
import textwrap

from splatreel.cli.printing import say
from splatreel.config import Config, Quality, preset
from splatreel.config.setting_values import shown
from splatreel.config.settings import sections, settings

WIDEST = 120
"""Largest number of columns of the list. Wider lines are hard to read."""


def config(quality: Quality = "standard", json: bool = False) -> None:
    """List every setting of a reconstruction with its value and its documentation. --set changes settings.

    Args:
        quality: Preset whose values are shown, with those of standard where they differ.
        json: Print everything as JSON.
    """
    chosen, standard = preset(quality), Config()
    if json:
        rows = {
            name: {"value": setting.of(chosen), "takes": str(setting.kind), "doc": setting.doc}
            for name, setting in settings().items()
        }
        return say(json_format.dumps({"quality": quality, "settings": rows}, indent=1))
    width = min(shutil.get_terminal_size((WIDEST, 24)).columns, WIDEST)
    say(
        f"Settings of --quality {quality}. Change any of them with --set NAME=VALUE, such as --set group.lambda_arap=0."
    )
    for section, purpose in sections().items():
        say("\n" + textwrap.fill(f"{section or 'general'}: {purpose}", width, subsequent_indent="    "))
        for setting in settings().values():
            if setting.section == section:
                value, usual = shown(setting.of(chosen)), shown(setting.of(standard))
                say(f"\n  {setting.name} = {value}{'' if value == usual else f'   (standard: {usual})'}")
                needs = "".join(f" Has an effect only with {need}." for need in setting.needs)
                text = f"{setting.doc} Takes {setting.kind}.{needs}"
                say(textwrap.fill(text, width, initial_indent="      ", subsequent_indent="      "))
    return None
