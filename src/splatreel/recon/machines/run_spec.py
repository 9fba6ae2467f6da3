"""A run, as processes and machines are told of it that take part in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.recon.jobs import ChapteredRun
from splatreel.recon.pipeline import plan_run


@dataclass(frozen=True)
class RunSpec:
    """What `reconstruct` is called with. It can be pickled.

    open_capture: called by each process that takes part, such as `functools.partial(open_capture, path, width=640)`.
    """

    open_capture: Callable[[], Capture]
    out: Path
    config: Config
    sound: str = "auto"
    device: str = "auto"

    @contextmanager
    def opened(self) -> Iterator[ChapteredRun]:
        """The run, with its capture open. Raises what opening that raises, and as `plan_run`."""
        capture = self.open_capture()
        try:
            yield plan_run(capture, self.out, self.config, sound=self.sound, device=self.device)
        finally:
            capture.close()
