from pathlib import Path

import numpy as np

from bench.speed import LoopedCapture
from tests.evaluation import scenes


def test_looped_capture_repeats_its_frames() -> None:
    source = scenes.capture(Path("x"), ["cam03"])
    looped, names = LoopedCapture(source, 12), ["cam01", "cam03"]
    assert (looped.frames, looped.held_out, looped.fps) == (12, ["cam03"], source.fps)
    once = source.read(0, scenes.FRAMES, names)
    np.testing.assert_array_equal(looped.read(0, 12, names), np.concatenate([once, once, once])[:12])
    np.testing.assert_array_equal(looped.read(4, 3, names), once[[4, 0, 1]])
    assert looped.fingerprint() != source.fingerprint()
