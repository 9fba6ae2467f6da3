"""The `splatreel` command: one module per verb, which parses, calls one function and prints."""

from __future__ import annotations

import dataclasses
import inspect
import os
import re
import sys
from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Any

from tyro.conf import DisallowNone
from tyro.extras import SubcommandApp

from splatreel import __version__
from splatreel.base.process import (
    check_address_space,
    choose_compile_cache,
    keep_freed_memory,
    open_standard_streams,
    quiet_threads,
)
from splatreel.base.progress import printable
from splatreel.cli.capture import (
    capture_board,
    capture_calibrate,
    capture_check,
    capture_convert,
    capture_film,
    capture_sync,
)
from splatreel.cli.capture_masks import capture_masks
from splatreel.cli.config import config
from splatreel.cli.demo import demo
from splatreel.cli.edit import edit
from splatreel.cli.encode import encode
from splatreel.cli.evaluate import evaluate
from splatreel.cli.export import export
from splatreel.cli.failure import deadline, explain, interruption, termination
from splatreel.cli.import_frames import import_frames
from splatreel.cli.info import info, verify
from splatreel.cli.machine import devices, warmup
from splatreel.cli.options import check_arguments
from splatreel.cli.printing import say
from splatreel.cli.publish import publish
from splatreel.cli.reconstruct import reconstruct
from splatreel.cli.serve import serve, view

_LIBRARY_BYTES = 900_000_000
"""Virtual memory that NumPy, SciPy and their threads take on a small machine."""

DESCRIPTION = "Volumetric video from many static cameras: reconstruct, compress, stream and play groups of Gaussians."


GROUPS = {
    "capture": "Synchronize, calibrate, check and convert a capture; make masks; film the built-in scene.",
}
"""Descriptions of verbs of two words, by their first word."""
VERBS: dict[str, Callable[..., None]] = {
    "demo": demo,
    "capture sync": capture_sync,
    "capture calibrate": capture_calibrate,
    "capture board": capture_board,
    "capture check": capture_check,
    "capture masks": capture_masks,
    "capture convert": capture_convert,
    "capture film": capture_film,
    "reconstruct": reconstruct,
    "config": config,
    "encode": encode,
    "import": import_frames,
    "edit": edit,
    "info": info,
    "verify": verify,
    "serve": serve,
    "view": view,
    "publish": publish,
    "export": export,
    "evaluate": evaluate,
    "devices": devices,
    "warmup": warmup,
}
"""Functions of the verbs, in the order in which users meet them."""

BREAK = re.compile(r"(?<=\S)\n(?: {8,}(?=\S)|(?=\S))")
"""A line break within a paragraph, or within the description of an argument in Google's style."""


def build(chosen: Sequence[str] = ()) -> SubcommandApp:
    """Return the app with all verbs.

    Args:
        chosen: Arguments of the command line. The verb among them gets its whole help, the others the first paragraph for the list.
    """
    app, groups = SubcommandApp(), {name: SubcommandApp() for name in GROUPS}
    for words, verb in VERBS.items():
        group, _, name = words.rpartition(" ")
        if group and not vars(groups[group]).get("__doc__"):
            groups[group].__doc__ = GROUPS[group]
            app.command(groups[group], name=group)
        summary, whole = join_lines(verb), list(chosen[: len(words.split())]) == words.split()
        (groups[group] if group else app).command(name=name, help=None if whole else summary)(verb)
    return app


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line.

    Args:
        arguments: Arguments of the command; by default those of the process.

    Returns:
        The exit code: 0 for success, 1 for errors, 2 for wrong use, 130 after Ctrl-C, 143 after SIGTERM.
    """
    open_standard_streams()
    alone = arguments is None
    given = sys.argv[1:] if arguments is None else list(arguments)
    quiet_threads()
    choose_compile_cache()
    keep_freed_memory()
    try:
        with termination(), deadline(lambda number: interruption(number, given), lasting=alone):
            if given == ["--version"]:
                say(f"splatreel {__version__}", flush=True)
                return 0
            check_arguments(given)
            words = [re.sub("^--licence(?==|$)", "--license", argument) for argument in given]
            check_address_space(_LIBRARY_BYTES)
            build(words).cli(prog="splatreel", description=DESCRIPTION, args=words, config=[DisallowNone])
    except BrokenPipeError:
        # The reader of the pipe is gone; print nothing at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (Exception, KeyboardInterrupt) as error:
        known = explain(error, given)
        if known is None:
            raise
        print(printable(known[0]), file=sys.stderr)
        return known[1]
    return 0
