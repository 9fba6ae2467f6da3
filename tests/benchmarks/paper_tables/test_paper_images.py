from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from paper_tables.image_crops import LABEL, SIDE
from paper_tables.paper_bench import Measured
from paper_tables.paper_run import write_table
from tests.benchmarks.paper_tables.test_paper_results import MadeUpBench
from tests.evaluation import scenes
from tests.evaluation.test_report import report


class RunBench(MadeUpBench):
    """Bench whose variants all are the run of the known scene."""

    def measure(self, capture: str, variant: str) -> Measured:
        run = self.out / "run"
        if not run.exists():
            scenes.write_run(run)
        return Measured(report(), 1, run)


@pytest.mark.parametrize(("number", "columns"), [("figure7", 6), ("figure8", 6), ("figure9", 3), ("figure12", 3)])
def test_figures_have_a_row_for_each_capture(number: str, columns: int, tmp_path: Path) -> None:
    text = write_table(RunBench(tmp_path), number, 1)
    image = np.asarray(Image.open(tmp_path / f"{number}.png"))
    assert image.shape == (2 * (LABEL + SIDE), columns * SIDE, 3)
    assert f"]({number}.png)" in text
    assert text.count("\n- ") == 2
    assert "- a, cam0" in text
    truth, ours = (image[LABEL : LABEL + SIDE, k * SIDE : (k + 1) * SIDE].astype(float) for k in (0, 1))
    assert np.abs(truth - ours).mean() < 12  # the reel shows the scene


def test_the_failure_shows_its_layers_in_blue(tmp_path: Path) -> None:
    write_table(RunBench(tmp_path, ("a",)), "figure12", 1)
    layers = np.asarray(Image.open(tmp_path / "figure12.png"))[LABEL:, 2 * SIDE :].astype(int)
    assert (layers[..., 2] > layers[..., 0] + 50).mean() > 0.1


@pytest.mark.slow
def test_figure_11_has_the_configurations_of_both_tables(tmp_path: Path) -> None:
    text = write_table(RunBench(tmp_path, ("a",)), "figure11", 1)
    assert np.asarray(Image.open(tmp_path / "figure11.png")).shape == (2 * (LABEL + SIDE), 8 * SIDE, 3)
    assert "Table 9: truth, #1" in text
    assert "Table 10: truth, #1" in text
