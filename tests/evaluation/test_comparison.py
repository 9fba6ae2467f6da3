from pathlib import Path

import numpy as np
from PIL import Image

from splatreel.evaluation.evaluate import comparison, write_png


def test_comparison_shows_truth_render_and_error(tmp_path: Path) -> None:
    truth, render = np.full((4, 5, 3), 0.5, np.float32), np.full((4, 5, 3), 0.6, np.float32)
    strip = comparison(truth, render)
    assert strip.shape == (4, 15, 3)
    assert [int(strip[0, x, 0]) for x in (0, 5, 10)] == [128, 153, 102]
    write_png(tmp_path / "made" / "a.png", strip)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "made" / "a.png")), strip)
    assert [p.name for p in (tmp_path / "made").iterdir()] == ["a.png"]
