"""The `splatreel` command: one module per verb, which parses, calls one function and prints."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from tyro.extras import SubcommandApp

from splatreel import __version__
from splatreel.base.compile_cache import choose_compile_cache
from splatreel.base.process import check_address_space, keep_freed_memory, open_standard_streams, quiet_threads
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
from splatreel.cli.import_frames import import_frames
from splatreel.cli.info import info
from splatreel.cli.options import check_arguments
from splatreel.cli.printing import say
from splatreel.cli.publish import publish
from splatreel.cli.reconstruct import reconstruct
from splatreel.cli.serve import serve, view
from splatreel.cli.verify import verify
from splatreel.cli.warmup import warmup

_LIBRARY_BYTES = 900_000_000
"""Virtual memory that NumPy, SciPy and their threads take on a small machine."""

DESCRIPTION = "Volumetric video from many static cameras: reconstruct, compress, stream and play groups of Gaussians."


def build() -> SubcommandApp:
    """Return the app with all verbs, in the order in which users meet them."""
    capture = SubcommandApp()
    capture.__doc__ = "Check, calibrate, synchronize and convert a capture; make masks; film the built-in scene."
    verbs = {"check": capture_check, "calibrate": capture_calibrate, "board": capture_board, "sync": capture_sync}
    verbs |= {"masks": capture_masks, "convert": capture_convert, "film": capture_film}
    for name, verb in verbs.items():
        capture.command(name=name)(verb)
    app = SubcommandApp()
    app.command(demo)
    app.command(capture, name="capture")
    for verb in (reconstruct, config, encode):
        app.command(verb)
    app.command(name="import")(import_frames)
    for verb in (edit, info, verify, serve, view, publish, export, evaluate, devices, warmup):
        app.command(verb)
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
            check_address_space(_LIBRARY_BYTES)
            build().cli(prog="splatreel", description=DESCRIPTION, args=arguments)
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
