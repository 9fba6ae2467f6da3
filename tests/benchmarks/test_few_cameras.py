"""Tables of the benchmark of few cameras."""

import dataclasses
import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest


@pytest.fixture
def few(benchmarks: Path) -> ModuleType:
    return importlib.import_module("few_cameras")


def measured(row: Any) -> dict[str, Any]:
    """Return a result like `measure`."""
    compared = [
        {"name": "a", "degrees": 54.6, "psnr": 20.0, "ssim": 0.7, "lpips": 0.3},
        {"name": "b", "degrees": 8.0, "psnr": 25.0, "ssim": 0.8, "lpips": None},
    ]
    return {"frames": 6, "bytes": 93456, "psnr": 22.5, "ssim": 0.75, "lpips": 0.3, "compared": compared}


def test_a_table_continues_after_an_interruption(
    few: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    results, asked = tmp_path / "results.jsonl", []
    rows = [few.Row("hall", ["1", "2"], masks, "draft", 320, "0:6", 0, ["a", "b"]) for masks in ("given", "automatic")]

    def once(row: Any) -> dict[str, Any]:
        asked.append(row.masks)
        if asked == ["given", "automatic"]:
            raise KeyboardInterrupt
        return measured(row)

    monkeypatch.setattr(few, "source", lambda: "0123abcd")
    with pytest.raises(KeyboardInterrupt):
        few.run_table(rows, once, results, "")
    few.run_table(rows, once, results, "")
    assert asked == ["given", "automatic", "automatic"], "the first row is recorded"
    few.run_table(rows, once, results, "")
    assert len(asked) == 3
    few.run_table(rows[:1], once, results, "another note")
    monkeypatch.setattr(few, "source", lambda: "0123abcd+")
    few.run_table(rows[:1], once, results, "")
    few.run_table(rows[:1], once, results, "")
    assert len(asked) == 6, "changed files may have changed again"
    assert "2 cameras (1,2), given masks, draft: 22.50 dB, SSIM 0.750, LPIPS 0.300, 93.5 kB" in capsys.readouterr().out


def test_compared_cameras_are_described_with_their_angle_nearest_first(few: ModuleType) -> None:
    row = few.Row("hall", ["1"], "given", "draft", 320, "0:6", 0, ["a", "b"])
    _, near, far = few.described(dataclasses.asdict(row) | measured(row)).splitlines()
    assert near == "  b at 8 degrees: 25.00 dB, SSIM 0.800"
    assert far == "  a at 55 degrees: 20.00 dB, SSIM 0.700, LPIPS 0.300"


def test_rows_have_folders_of_their_own(few: ModuleType) -> None:
    row = few.Row("hall", ["1", "2"], "given", "draft", 320, "0:6", 0, ["a"])
    others = {"cameras": ["1", "3"], "masks": "automatic, networks", "width": 160, "span": "6:12", "seed": 1}
    names = {dataclasses.replace(row, **{name: value}).name for name, value in others.items()} | {row.name}
    assert len(names) == 6


def test_small_parts_of_masks_are_not_counted(benchmarks: Path) -> None:
    import numpy as np

    masks = importlib.import_module("masks")
    mask = np.zeros((100, 100), bool)
    mask[20:60, 20:60] = mask[80:83, 80:83] = mask[97:, 50:53] = True
    found = masks.blobs(mask)
    assert found[80:83, 80:83].all()
    assert not found[20:60, 20:60].any()
    assert not found[97:, 50:53].any(), "a body that the border cuts"
