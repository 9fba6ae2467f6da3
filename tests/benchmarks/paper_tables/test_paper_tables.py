"""The paper's tables of encodings, of one run."""

import re
from pathlib import Path

import pytest

from bench.rate_distortion import Sweep
from paper_tables.paper_tables import paper_tables
from splatreel.base.progress import Silent
from tests.evaluation import scenes


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scenes.write_run(tmp_path_factory.mktemp("rates") / "run")


def cells(text: str, title: str) -> list[list[str]]:
    """Return the rows of a table below its header."""
    found = text[text.index(title) :].split("\n\n")[1]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in found.splitlines()[2:]]


def test_paper_tables_have_all_rows(run: Path) -> None:
    capture = scenes.capture(run)
    sweep, first = (Sweep(run, capture, frames, Silent()) for frames in ([0, 4], [0]))
    text = paper_tables(sweep, first)
    nine, ten = cells(text, "Table 9."), cells(text, "Table 10.")
    assert [row[0] for row in nine] == ["#1", "#2", "#3", "#4", "#5", "#6"]
    assert [row[1] for row in ten] == ["-", "ofs", "ofs", "ofs", "ofs", "ori", "dif"]
    assert float(nine[0][6]) == pytest.approx(first.before, abs=0.01)  # float32 is what was trained
    assert (nine[0][8], ten[0][6]) == ("100.0%", "100.0%")
    sizes = [float(row[7]) for row in nine]
    assert sizes[0] > sizes[1] > sizes[2] > sizes[3]
    assert float(nine[2][6]) > float(nine[3][6])  # scales with 8 linear bits
    eight = {row[0]: row[1:] for row in cells(text, "Table 8.")}
    for column in range(4):
        parts = float(eight["Size (points)"][column]) + float(eight["Size (deformations)"][column])
        assert parts == pytest.approx(float(eight["Size (whole model)"][column]), rel=0.02)
    assert eight["Time"][3] == "1.5"
    four = {row[0]: row[1:] for row in cells(text, "Table 4.")}
    assert float(four["Size"][0]) > float(four["Size"][2])
    assert re.fullmatch(r"\d+\.\d\d", four["PSNR"][1])
