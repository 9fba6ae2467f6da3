from dataclasses import replace
from pathlib import Path

import pytest

from paper_tables.paper_bench import BASELINES, FULL, INDEPENDENT, VARIANTS, Measured, PaperBench
from paper_tables.paper_comparisons import COMPARISONS
from paper_tables.paper_images import IMAGES
from paper_tables.paper_results import RESULTS, chained_groups
from paper_tables.paper_run import TITLES, variants_of, write_table
from splatreel.base.errors import UsageError
from splatreel.base.progress import Silent
from splatreel.capture.base import Capture
from splatreel.config import Config, preset
from tests.evaluation import scenes
from tests.evaluation.test_report import report

PSNR = {FULL: 32.0, "w/o Reg.": 31.9, "w/o Prg.": 31.5, "w/o Adp.": 31.8, "w/o Rfn.": 30.0}


class MadeUpBench(PaperBench):
    """Bench with made-up reports: the second capture has 2 dB and a megabyte more. It records what was asked for."""

    def __init__(self, out: Path, names: tuple[str, ...] = ("a", "b"), config: Config | None = None) -> None:
        captures: dict[str, Capture] = {name: scenes.capture(out) for name in names}
        super().__init__(captures, config or preset("paper"), out, "cpu", Silent())
        self.asked: set[str] = set()

    def measure(self, capture: str, variant: str) -> Measured:
        self.asked.add(variant)
        more = 2 * list(self.captures).index(capture)
        psnr = PSNR.get(variant, 31.0) + more
        size = 2_000_000 + 500_000 * more
        frames = [{"frame": index, "psnr": psnr - 0.1 * index} for index in range(3)]
        made = report(psnr=psnr, lpips=0.1, reel_bytes=size, per_frame=frames, decode_ms_per_frame=4.0)
        return Measured(
            replace(made, seconds={"keyframe": 60.0, "group": 60.0, "evaluate": 999.0}), 10 * size, self.out
        )


def test_table_6_averages_over_captures(tmp_path: Path) -> None:
    table = RESULTS["6"].table(bench := MadeUpBench(tmp_path))
    assert list(table.rows[0]) == [FULL, "33.000", "0.9500", "0.1000", "2.50", "10.00%"]
    assert [row[0] for row in table.rows] == list(RESULTS["6"].variants)
    assert table.rows[4][1] == "31.000"
    assert bench.asked == set(RESULTS["6"].variants)
    assert "are those of Full" not in table.caption


def test_table_6_names_variants_that_change_nothing(tmp_path: Path) -> None:
    table = RESULTS["6"].table(MadeUpBench(tmp_path, config=preset("standard")))
    assert "The settings of w/o Prg. are those of Full here." in table.caption


class OneGroup(MadeUpBench):
    """Bench of captures of one group, in which the variants of Table 6 differ in nothing but their settings."""

    moves = True

    def measure(self, capture: str, variant: str) -> Measured:
        found = super().measure(capture, FULL)
        return replace(found, report=replace(found.report, points_dynamic=100.0 if self.moves else 0.0))


@pytest.mark.parametrize(("moves", "cause"), [(True, "the video has one group"), (False, "nothing moves")])
def test_equal_rows_are_explained(tmp_path: Path, moves: bool, cause: str) -> None:
    bench = OneGroup(tmp_path, config=preset("standard"))
    bench.moves = moves
    caption = RESULTS["6"].table(bench).caption
    assert "The settings of w/o Prg. are those of Full here." in caption
    assert f"w/o Reg., w/o Adp. and w/o Rfn. gave the same reel as Full, because {cause}" in caption
    for number, first in (("7", "length 10"), ("13", FULL), ("figure10", FULL)):
        assert f"gave the same reel as {first}, because" in RESULTS[number].table(bench).caption


def test_the_papers_numbers_stand_beside_those_of_its_captures(tmp_path: Path) -> None:
    bench = MadeUpBench(tmp_path, ("flame_steak", "sear_steak"))
    table = RESULTS["6"].table(bench)
    assert table.heads[6] == "paper: PSNR ↑"
    assert list(table.rows[4][6:]) == ["31.205", "0.9398", "0.1353", "20.62", "8.86%"]
    assert [row[0] for row in RESULTS["7"].table(bench).rows][3:] == ["paper: PSNR ↑", "paper: Size ↓", "paper: Time ↓"]


def test_table_7_has_a_column_a_length(tmp_path: Path) -> None:
    table = RESULTS["7"].table(MadeUpBench(tmp_path))
    assert list(table.heads) == ["Group Length", "10", "20", "30", "40", "50"]
    assert list(table.rows[2]) == ["Time ↓", *["2.0"] * 5]  # evaluation does not count


def test_table_12_has_the_time_of_each_procedure(tmp_path: Path) -> None:
    rows = {row[0]: row[1:] for row in RESULTS["12"].table(MadeUpBench(tmp_path)).rows}
    assert list(rows["Gaussian Point Init."]) == ["1.00 min", f"{60 / scenes.FRAMES:.2f} s", "20,000 (5,000)/group"]
    assert list(rows["Decoding"]) == [f"{4 * scenes.FRAMES} ms", "4.0 ms", "-"]


def test_tables_13_and_14_have_rows_of_each_capture(tmp_path: Path) -> None:
    bench = MadeUpBench(tmp_path)
    assert [row[0] for row in RESULTS["13"].table(bench).rows] == ["a", "a", "b", "b", "Average", "Average"]
    rows = RESULTS["14"].table(bench).rows
    assert [row[:2] for row in map(list, rows)] == [
        ["a", "Ours*"],
        ["a", "Ours"],
        ["b", "Ours*"],
        ["b", "Ours"],
        ["Average", "Ours"],
    ]
    assert list(rows[4][2:]) == ["33.000", "0.9500", "0.1000", "2.50"]


def test_figure_10_has_a_curve_a_variant(tmp_path: Path) -> None:
    table = RESULTS["figure10"].table(MadeUpBench(tmp_path))
    assert [list(row) for row in table.rows] == [
        ["0", "33.000", "31.000"],
        ["1", "32.900", "30.900"],
        ["2", "32.800", "30.800"],
    ]


@pytest.mark.parametrize("table", [*RESULTS, *COMPARISONS])
def test_a_result_needs_only_the_variants_that_its_plan_names(table: str, tmp_path: Path) -> None:
    bench = MadeUpBench(tmp_path)
    scenes.write_reel(tmp_path / "reel")
    text = write_table(bench, table, 1)
    assert bench.asked <= set(variants_of(table)) <= {*VARIANTS, *BASELINES}
    name = f"table-{table}" if table[0].isdigit() else table
    assert text.startswith((tmp_path / f"{name}.md").read_text()[:40])
    assert {f"{name}.csv", f"{name}.md", f"{name}.tex"} <= {path.name for path in tmp_path.iterdir()}


def test_config_1_of_table_8_counts_points_and_offsets_of_all_groups(tmp_path: Path) -> None:
    scenes.write_reel(tmp_path / "reel")
    measured = replace(MadeUpBench(tmp_path).measure("a", FULL), run=tmp_path)
    found = chained_groups(measured)
    assert (found.points, found.offsets) == (200 * 59 * 4, 200 * 7 * 4 * scenes.FRAMES)
    assert found.minutes == 2
    assert set(variants_of("8")) == {FULL, INDEPENDENT}


def test_unknown_tables_are_refused_with_the_known_ones() -> None:
    with pytest.raises(
        UsageError, match=r"--table '99' is not one of: 1 \(comparison with other methods\), 2 \(quality, size"
    ):
        variants_of("99")
    assert variants_of("10") == (FULL,)
    assert set(TITLES) == {*map(str, range(1, 11)), "12", "13", "14", "baselines", "figure10", "figure15", *IMAGES}
