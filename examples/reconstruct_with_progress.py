"""Reconstruct a capture and follow its progress in your own program.

python examples/reconstruct_with_progress.py CAPTURE --out out/mine

`reconstruct` calls three methods of the progress object: when a stage starts, after steps of it, and for remarks worth keeping. Any
object with these methods will do: one that updates a web page, or a job queue. `progress=True` shows the bars of the command line, or
those of a notebook.
"""

import logging
from pathlib import Path

import tyro
from tyro.conf import Positional

import splatreel

logger = logging.getLogger("reconstruction")


class LoggedProgress:
    """Progress of a reconstruction as log lines, one for each tenth of a stage."""

    def __init__(self) -> None:
        self.name, self.total, self.tenth = "", 1, 0

    def stage(self, name: str, total: int, span: tuple[float, float] | None = None) -> None:
        """Start a stage of `total` steps. `span` is its part of the whole run, such as (0.2, 0.7), where that is known."""
        self.name, self.total, self.tenth = name, total, 0
        logger.info("%s%s", name, "" if span is None else f" ({100 * span[0]:.0f} % of the run done)")

    def update(self, done: int, **numbers: float) -> None:
        """Report the steps that are done, with numbers such as psnr=29.1."""
        tenth = 10 * done // max(self.total, 1)
        if tenth > self.tenth:
            self.tenth = tenth
            logger.info("%s: %d %% %s", self.name, 10 * tenth, {key: round(value, 3) for key, value in numbers.items()})

    def note(self, text: str) -> None:
        """Report a remark."""
        logger.info("%s", text)


def main(capture: Positional[str], out: Path = Path("out/mine"), frames: int = 60, width: int | None = None) -> None:
    """Reconstruct the first frames of a capture. The same command continues an interrupted run.

    Args:
        capture: Folder of the capture.
        out: Folder of the run; the reel is written to its subfolder `reel`.
        frames: Number of frames.
        width: Width in pixels to train at; by default the capture's.
    """
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    opened = splatreel.open_capture(capture, frames=(0, frames), width=width)
    result = splatreel.reconstruct(opened, out, splatreel.preset("draft"), progress=LoggedProgress())
    print(f"{result.reel}: {sum(result.seconds.values()):.0f} s on {result.device}")


if __name__ == "__main__":
    tyro.cli(main)
