from pathlib import Path

import pytest
from paper_tables.paper_bench import BASELINES, NO_LAYERS
from paper_tables.paper_comparisons import COMPARISONS
from paper_tables.published import TABLE_1, TABLE_2, comparable, dataset_of, published_rows

from tests.evaluation import scenes
from tests.evaluation.bench.test_paper_results import MadeUpBench


class BenchWithReel(MadeUpBench):
    """Bench whose runs have the reel of the known scene."""

    def __init__(self, out: Path, names: tuple[str, ...]) -> None:
        super().__init__(out, names)
        scenes.write_reel(out / "reel")


@pytest.fixture
def bench(tmp_path: Path) -> BenchWithReel:
    return BenchWithReel(tmp_path, ("a", "b"))


def test_all_baselines_stand_beside_ours(bench: BenchWithReel) -> None:
    table = COMPARISONS["baselines"].table(bench)
    rows = {row[0]: list(row[1:]) for row in table.rows}
    assert list(rows) == [*BASELINES, NO_LAYERS, "Ours"]
    assert rows["Ours"][:1] == ["33.000"]
    assert rows["Ours"][5:] == ["2.500", f"{2500 / scenes.FRAMES:.1f}", "25.00", "2.00"]


def test_measured_rows_come_first_and_published_ones_say_so(bench: BenchWithReel) -> None:
    table = COMPARISONS["1"].table(bench)
    sources = [row[-1] for row in table.rows]
    assert sources[:5] == ["measured"] * 5
    assert all(source.startswith("published, ") for source in sources[5:])
    assert len(sources) == 5 + 3 * 7
    assert "they cannot be compared" in table.caption
    assert list(table.rows[4]) == ["Ours", "33.00", "0.950", "0.100", "2.50", "measured"]


def test_the_papers_rows_are_those_of_the_captures_dataset(tmp_path: Path) -> None:
    bench = BenchWithReel(tmp_path, ("Birthday", "Train"))
    table = COMPARISONS["1"].table(bench)
    assert {row[-1] for row in table.rows} == {"measured", "published, Technicolor"}
    assert "they cannot be compared" not in table.caption
    assert ["4DGV", "31.77", "0.893", "0.197", "40.2", "published, Technicolor"] in [list(row) for row in table.rows]


def test_table_5_counts_the_points_of_the_reel(bench: BenchWithReel) -> None:
    assert list(COMPARISONS["5"].table(bench).rows[0][4:]) == ["2.00", "300", "measured"]  # 100 static, 200 dynamic


def test_figure_15_has_published_points_of_the_same_captures_only(bench: BenchWithReel, tmp_path: Path) -> None:
    assert {row[3] for row in COMPARISONS["figure15"].table(bench).rows} == {"measured"}
    found = COMPARISONS["figure15"].table(BenchWithReel(tmp_path / "b", ("flame_steak",))).rows
    assert ["3DGStream", "2430", "31.67", "published, Neu3DV"] in [list(row) for row in found]
    assert not any(row[0] == "4DGS" for row in found)  # its size is not known


def test_datasets_are_known_by_their_scenes() -> None:
    assert dataset_of(["flame_steak", "Sear_Steak"]) == "Neu3DV"
    assert dataset_of(["flame_steak", "Birthday"]) is None
    assert len(published_rows(TABLE_2, ["kitchen"])) == 15
    assert "cannot be compared" in comparable(TABLE_1, ["flame_steak"])  # Table 1 has no Neu3DV
