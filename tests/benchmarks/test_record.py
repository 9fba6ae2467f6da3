import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).parent.parent.parent / "benchmarks"


@pytest.fixture
def record() -> ModuleType:
    spec = importlib.util.spec_from_file_location("record", FOLDER / "record.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_lines_are_appended_and_labelled(record: ModuleType, tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    record.record("demo", {"psnr": 30.5}, "idle", file)
    record.record("demo", record.summary({"psnr": 31.5, "cameras": [1], "per_frame": [2]}), results=file)
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    assert [line["psnr"] for line in lines] == [30.5, 31.5]
    assert lines[0]["note"] == "idle"
    assert "cameras" not in lines[1]
    assert set(lines[0]) == {"benchmark", "revision", "date", "machine", "note", "psnr"}


def test_documents_show_what_the_project_records(
    record: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))
    table = importlib.import_module("table")
    page, file = tmp_path / "page.md", tmp_path / "results.jsonl"
    page.write_text(f"{table.BEGIN}\n{table.END}\n")
    monkeypatch.setattr(table, "documents", lambda records: {page: records["demo"]["note"]})
    monkeypatch.setattr(record, "RESULTS", file)
    record.record("demo", {"psnr": 30.5}, "idle", file)
    assert "idle" in page.read_text()
    record.record("demo", {"psnr": 30.5}, "elsewhere", tmp_path / "others.jsonl")
    assert "elsewhere" not in page.read_text()


def test_committed_results_are_readable() -> None:
    file = FOLDER / "results.jsonl"
    lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    assert len(lines) > 300  # lines are only ever appended
    assert [line for line in lines if not {"benchmark", "revision", "date", "machine"} <= set(line)] == []
