"""Help texts of the verbs, as they are printed: paragraphs without the line breaks of the source."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable
from types import MappingProxyType
from typing import Any

BREAK = re.compile(r"(?<=\S)\n(?: {8,}(?=\S)|(?=\S))")
"""A line break within a paragraph, or within the description of an argument in Google's style."""


def join_lines(verb: Callable[..., None]) -> str:
    """Join the lines of each paragraph and option in the help of a verb: tyro would print some of these line breaks.

    Args:
        verb: Function of the verb. Its groups of options are dataclasses, which are the defaults of parameters.

    Returns:
        The first paragraph, for the list of verbs.
    """
    verb.__doc__ = BREAK.sub(" ", inspect.cleandoc(verb.__doc__ or ""))
    for parameter in inspect.signature(verb).parameters.values():
        if dataclasses.is_dataclass(parameter.default):
            _join_lines_of_options(type(parameter.default))
    return verb.__doc__.partition("\n\n")[0]


def _join_lines_of_options(options: type[Any]) -> None:
    import docstring_parser  # a dependency of tyro

    texts = {text.arg_name: text.description for text in docstring_parser.parse_from_object(options).params}
    for field in dataclasses.fields(options):
        if text := texts.get(field.name):
            # tyro takes the help of a field from here, before it looks at the docstring.
            field.metadata = MappingProxyType({**field.metadata, "help": " ".join(text.split())})
