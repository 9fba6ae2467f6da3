"""A finished stage is not run again after an interruption."""

from pathlib import Path

import pytest

from splatreel.base.progress import Span
from splatreel.run.pipeline import reconstruct
from tests.method.captures import WallCapture
from tests.run.test_pipeline import CONFIG, FRAMES, Trace, content


class StopAt(Trace):
    """Raises when a stage begins."""

    def __init__(self, what: str) -> None:
        super().__init__()
        self.what = what

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        super().stage(name, total, span)
        if self.what in name:
            raise KeyboardInterrupt


def test_finished_stage_is_not_run_again(tmp_path: Path) -> None:
    stages = ["training the first keyframe", "separating static", "tracking moving points", "training the motion"]
    for done, what in enumerate(stages[1:]):
        trace = StopAt(what)
        with pytest.raises(KeyboardInterrupt):
            reconstruct(WallCapture(FRAMES), tmp_path / "stopped", CONFIG, progress=trace)
        assert not [name for name, _, _ in trace.stages if any(stage in name for stage in stages[:done])]
    trace = Trace()
    reconstruct(WallCapture(FRAMES), tmp_path / "stopped", CONFIG, progress=trace)
    assert not [name for name, _, _ in trace.stages if name.startswith("group 1") and stages[2] in name]
    whole = reconstruct(WallCapture(FRAMES), tmp_path / "whole", CONFIG)
    assert content(tmp_path / "stopped" / "reel") == content(whole.reel)
