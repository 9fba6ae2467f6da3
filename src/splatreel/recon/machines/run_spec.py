"""Description of a run for the processes and machines that take part in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from splatreel.capture.base import Capture
from splatreel.capture.opening import CaptureSource
from splatreel.config import Config
from splatreel.recon.jobs import ChapteredRun
from splatreel.recon.pipeline import plan_run
from splatreel.recon.run.store import Store


@dataclass(frozen=True)
class RunSpec:
    """Arguments of `pipeline.reconstruct`, in a form that can be pickled.

    Attributes:
        open_capture: Called by each process to open the capture, such as `CaptureSource(path, {"width": 640})`. A `CaptureSource` gets
            the frame tables of the run, so that no video is scanned twice.
        out: Output folder.
        config: Settings.
        sound: The soundtrack.
        device: auto, cpu or cuda.
    """

    open_capture: Callable[[], Capture] | CaptureSource
    out: Path
    config: Config
    sound: str = "auto"
    device: str = "auto"

    @contextmanager
    def opened(self) -> Iterator[ChapteredRun]:
        """Give the run, with its capture open.

        Raises:
            SplatreelError: As opening the capture or `plan_run` raises it.
        """
        known = Store(self.out / "work").tables_file
        source = self.open_capture
        capture = source(known) if isinstance(source, CaptureSource) else source()
        try:
            yield plan_run(capture, self.out, self.config, sound=self.sound, device=self.device)
        finally:
            capture.close()
