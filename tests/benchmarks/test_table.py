import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parent.parent.parent
RECORD = {
    "benchmark": "basketball 320",
    "revision": "abc1234",
    "date": "2030-01-01 00:00",
    "machine": "2 cores, load 1.9",
    "machine_before": "2 cores, load 0.1",
    "psnr": 29.5,
    "psnr_per_channel": 29.75,
    "ssim": 0.91,
    "psnr_undecoded": None,
    "reel_bytes": 2_340_000,
    "share_of_float32": 0.0813,
    "seconds_total": 390.0,
    "peak_memory_bytes": 1.5e9,
    "frames": 60,
    "width": 320,
    "height": 180,
}


@pytest.fixture
def table(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    monkeypatch.delitem(sys.modules, "record", raising=False)
    spec = importlib.util.spec_from_file_location("table", ROOT / "benchmarks" / "table.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_latest_record_of_a_benchmark_counts(table: ModuleType, tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    file.write_text("".join(json.dumps(RECORD | {"psnr": psnr}) + "\n" for psnr in (28.0, 29.5)))
    assert table.latest(file)["basketball 320"]["psnr"] == 29.5
    assert table.latest(tmp_path / "none.jsonl") == {}


def test_rows_say_what_was_measured_and_what_was_not(table: ModuleType) -> None:
    oracle = RECORD | {"benchmark": "oracle coffee 320", "frames": 4}
    text = table.table({"basketball 320": RECORD, "oracle coffee 320": oracle})
    row = next(line for line in text.splitlines() if "60 at 320x180" in line)
    for cell in (
        "60 at 320x180",
        "29.50",
        "29.75",
        "0.9100",
        "2.34 MB",
        "8.1 %",
        "6.5 min",
        "0.1",
        "1.5 GB",
        "`abc1234`",
    ):
        assert f"| {cell} |" in row
    assert row.count(table.MISSING) == 1  # psnr_undecoded
    assert "| coffee, 320 wide, each frame on its own | 4 at 320x180 |" in text
    # The built-in capture, without LPIPS and fitted colors.
    assert text.splitlines()[2].count(table.MISSING) == len(table.COLUMNS) - 3
    assert text.endswith("Measured on 2 cores.")


def test_fitted_colors_have_a_column_once_a_row_has_them(table: ModuleType) -> None:
    assert "colors fitted" not in table.table({"yard": RECORD})
    rows = table.table({"yard": RECORD | {"psnr_color_fitted": 31.25}}).splitlines()
    place = rows[0].split(" | ").index("colors fitted")
    assert [row.split(" | ")[place] for row in rows if "29.50" in row] == ["31.25"]


def test_lpips_has_a_column_once_a_row_has_it(table: ModuleType) -> None:
    assert "LPIPS" not in table.short_table({"basketball 320": RECORD})
    measured = {"basketball 320": RECORD | {"lpips": 0.1234}, "yard": RECORD | {"lpips": None}}
    for text in (table.short_table(measured), table.table(measured)):
        rows = text.splitlines()
        place = rows[0].split(" | ").index("LPIPS")
        assert [row.split(" | ")[place] for row in rows if "29.50" in row] == ["0.1234", table.MISSING]


def test_seeds_at_one_revision_give_a_mean_and_a_spread(table: ModuleType, tmp_path: Path) -> None:
    older = RECORD | {"revision": "0000000", "psnr": 10.0, "seed": 5}
    first, again = RECORD | {"psnr": 20.0}, RECORD | {"psnr": 29.0, "seed": 0}
    others = [RECORD | {"psnr": 29.5, "seed": 1, "lpips": 0.1}, RECORD | {"psnr": 30.3, "seed": 2, "ssim": 0.94}]
    yard = RECORD | {"benchmark": "yard"}
    file = tmp_path / "results.jsonl"
    file.write_text("".join(json.dumps(record) + "\n" for record in (older, first, again, *others, yard)))
    records = table.latest(file)
    for text in (table.table(records), table.short_table(records)):
        row = next(line for line in text.splitlines() if "basketball, 320" in line)
        assert "| 29.60 ± 0.66 | " in row  # 29, 29.5, 30.3
        assert "| 0.9200 ± 0.0173 | " in row
        assert "| 2.34 ± 0.00 MB |" in row
        assert "±" not in next(line for line in text.splitlines() if line.startswith("| yard"))
        assert text.endswith("± is the standard deviation over 3 seeds. Rows without it are of one seed.")
    assert "seeds" not in records["yard"]
    assert "±" not in table.short_table({"yard": records["yard"]})


def test_only_what_stands_between_the_markers_is_replaced(table: ModuleType) -> None:
    text = f"before\n{table.BEGIN}\nold\n{table.END}\nafter\n"
    assert table.replaced(text, "new") == f"before\n{table.BEGIN}\nnew\n{table.END}\nafter\n"
    with pytest.raises(ValueError, match="no place for results"):
        table.replaced("nothing here", "new")


def test_documents_show_the_recorded_results(table: ModuleType) -> None:
    for document, inner in table.documents(table.latest()).items():
        text = document.read_text(encoding="utf-8")
        assert text == table.replaced(text, inner), "run: python benchmarks/table.py"


def test_the_papers_tables_are_in_order_and_name_what_they_were_measured_on(table: ModuleType) -> None:
    made = {"captures": {"kitchen": "60 at 320x180"}, "quality": "draft", "revision": "abc1234"}
    records = {f"paper {name}": made | {"markdown": f"| {name} |\n"} for name in ("figure10", "12", "4", "baselines")}
    records["paper 12"] |= {"settings": ["group.length=12"]}
    text = table.paper_tables(records | {"yard": RECORD})
    heads = [line for line in text.splitlines() if line.startswith("## ")]
    assert heads == ["## Table 4", "## Table 12", "## Baselines", "## Figure 10"]
    assert text.count("Measured at `draft` on kitchen (60 at 320x180); commit `abc1234`.") == 1
    assert "Measured at `draft`, `group.length=12` on kitchen" in text
    assert "| 12 |" in text


def test_the_readmes_table_is_a_part_of_the_pages(table: ModuleType) -> None:
    text = table.short_table({"basketball 320": RECORD})
    assert "| Panoptic basketball, 320 wide | 60 at 320x180 | 29.50 | 0.9100 | 2.34 MB |" in text.splitlines()
    assert len(text.splitlines()) == 2 + len(table.SHORT_ROWS)
