"""The `splatreel` command: one module per verb, which parses, calls one function and prints."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence

from tyro.conf import DisallowNone
from tyro.extras import SubcommandApp

from splatreel import __version__
from splatreel.base.compile_cache import choose_compile_cache
from splatreel.base.process import keep_freed_memory, open_standard_streams, quiet_threads
from splatreel.base.progress import printable
from splatreel.cli import bench
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
from splatreel.cli.deadline import deadline
from splatreel.cli.demo import demo
from splatreel.cli.devices import devices
from splatreel.cli.edit import edit
from splatreel.cli.encode import encode
from splatreel.cli.evaluate import evaluate
from splatreel.cli.export import export
from splatreel.cli.failure import explain, interruption, termination
from splatreel.cli.help_text import join_lines
from splatreel.cli.import_frames import import_frames
from splatreel.cli.info import info
from splatreel.cli.options import check_arguments
from splatreel.cli.printing import say
from splatreel.cli.publish import publish
from splatreel.cli.reconstruct import reconstruct
from splatreel.cli.serve import serve, view
from splatreel.cli.verify import verify
from splatreel.cli.warmup import warmup

DESCRIPTION = "Volumetric video from many static cameras: reconstruct, compress, stream and play groups of Gaussians."


def build(chosen: Sequence[str] = ()) -> SubcommandApp:
    """Return the app with all verbs, in the order in which users meet them.

    Args:
        chosen: Arguments of the command line. The verb among them gets its whole help, the others the first paragraph for the list.
    """
    words = list(chosen)
    capture = SubcommandApp()
    capture.__doc__ = "Synchronize, calibrate, check and convert a capture; make masks; film the built-in scene."
    verbs = {"sync": capture_sync, "calibrate": capture_calibrate, "board": capture_board, "check": capture_check}
    verbs |= {"masks": capture_masks, "convert": capture_convert, "film": capture_film}
    for name, verb in verbs.items():
        summary = join_lines(verb)
        capture.command(name=name, help=None if words[:2] == ["capture", name] else summary)(verb)
    app = SubcommandApp()
    verbs = {"demo": demo, "capture": capture, "reconstruct": reconstruct, "config": config, "encode": encode}
    verbs |= {"import": import_frames, "edit": edit, "info": info, "verify": verify, "serve": serve, "view": view}
    verbs |= {"publish": publish, "export": export, "evaluate": evaluate, "devices": devices, "warmup": warmup}
    for name, verb in verbs.items():
        if isinstance(verb, SubcommandApp):
            app.command(verb, name=name)
        else:
            summary = join_lines(verb)
            app.command(name=name, help=None if words[:1] == [name] else summary)(verb)
    app.command(bench.build(), name="bench")
    return app


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line.

    Args:
        arguments: Arguments of the command; by default those of the process.

    Returns:
        The exit code: 0 for success, 1 for errors, 2 for wrong use, 130 after Ctrl-C, 143 after SIGTERM.
    """
    open_standard_streams()
    alone = arguments is None
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    quiet_threads()
    choose_compile_cache()
    keep_freed_memory()
    try:
        with termination(), deadline(lambda number: interruption(number, arguments), lasting=alone):
            if arguments == ["--version"]:
                say(f"splatreel {__version__}", flush=True)
                return 0
            check_arguments(arguments)
            arguments = [re.sub("^--licence(?==|$)", "--license", argument) for argument in arguments]
            build(arguments).cli(prog="splatreel", description=DESCRIPTION, args=arguments, config=[DisallowNone])
    except BrokenPipeError:
        # The reader of the pipe is gone; print nothing at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (Exception, KeyboardInterrupt) as error:
        known = explain(error, arguments)
        if known is None:
            raise
        print(printable(known[0]), file=sys.stderr)
        return known[1]
    return 0
