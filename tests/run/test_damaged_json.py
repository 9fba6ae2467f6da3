"""JSON checkpoints with values of wrong types: the error names the file and the remedy."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import ReconstructionError
from splatreel.evaluation.report import Report
from splatreel.run.output.sound_output import load_soundtrack
from splatreel.run.run_folder import check_record
from splatreel.run.store import Store, load_arrays, save_arrays

LAYOUT = {"near": 0.1, "unit": 4.0, "up": [0, -1, 0], "bounds": [[0, 0, 0], [1, 1, 1]]}
HEADER = {
    "fps": 30,
    "group_length": 30,
    "overlap": 2,
    "sh_degree": 1,
    "bounds": [[0, 0, 0], [1, 1, 1]],
    "up": [0, -1, 0],
    "camera": {"name": "a", "width": 8, "height": 8, "K": [8, 0, 4, 0, 8, 4, 0, 0, 1], "viewmat": [1.0, *[0.0] * 15]},
    "cameras": [],
}
COVERAGE = {"names": ["a"], "angles": [1.0], "shared": [3], "points": 3, "trial": None}


def layout(work: Path) -> object:
    (work / "points.safetensors").write_bytes(b"")
    return Store(work).layout()


CASES: list[tuple[str, Callable[[Path], object], Any]] = [
    ("chapters.json", lambda work: Store(work).chapter_firsts(), {"a": 1}),
    ("chapters.json", lambda work: Store(work).chapter_firsts(), ["0"]),
    ("chapters.json", lambda work: Store(work).chapter_firsts(), [True, 4]),
    ("layout.json", layout, []),
    ("layout.json", layout, LAYOUT | {"near": "0.1"}),
    ("layout.json", layout, LAYOUT | {"up": [0, "-1", 0]}),
    ("layout.json", layout, LAYOUT | {"clearance": 5}),
    ("layout.json", layout, LAYOUT | {"more": 5}),
    ("header.json", lambda work: Store(work).header(), 7),
    ("header.json", lambda work: Store(work).header(), HEADER | {"fps": "30"}),
    ("header.json", lambda work: Store(work).header(), HEADER | {"fps": True}),
    ("header.json", lambda work: Store(work).header(), HEADER | {"cameras": 3}),
    ("header.json", lambda work: Store(work).header(), HEADER | {"camera": None}),
    ("header.json", lambda work: Store(work).header(), HEADER | {"limits": []}),
    ("coverage.json", lambda work: Store(work).coverage(), "a"),
    ("coverage.json", lambda work: Store(work).coverage(), COVERAGE | {"angles": ["1"]}),
    ("coverage.json", lambda work: Store(work).coverage(), COVERAGE | {"trial": {"psnr": "30"}}),
    ("seconds.json", lambda work: Store(work).seconds(), [1]),
    ("seconds.json", lambda work: Store(work).seconds(), {"points": "1"}),
    ("sound/choice.json", load_soundtrack, [1, 2]),
    ("sound/choice.json", load_soundtrack, {"camera": "a", "channels": "2", "position": [0, 0, 0]}),
    ("run.json", lambda work: check_record(work, {"config": {"seed": 1}}), [[]]),
    ("run.json", lambda work: check_record(work, {"config": {"seed": 1}}), {"config": 3}),
]


@pytest.mark.parametrize(("name", "load", "value"), CASES)
def test_values_of_wrong_types_are_reported(
    tmp_path: Path, name: str, load: Callable[[Path], object], value: Any
) -> None:
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(value))
    with pytest.raises(ReconstructionError, match="elete") as caught:
        load(tmp_path)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("text", ["[" * 5000, "", "{" + '"a": 1,' * 10])
def test_invalid_json_is_reported(tmp_path: Path, text: str) -> None:
    (tmp_path / "chapters.json").write_text(text)
    with pytest.raises(ReconstructionError, match=r"chapters\.json: .*elete it and run again"):
        Store(tmp_path).chapter_firsts()


def test_valid_json_is_read(tmp_path: Path) -> None:
    (tmp_path / "header.json").write_text(json.dumps(HEADER))
    (tmp_path / "layout.json").write_text(json.dumps(LAYOUT))
    assert Store(tmp_path).header()[0].fps == 30
    assert layout(tmp_path) is not None


@pytest.mark.parametrize("name", ["raw_means", "decoded_sh", "fineness"])
def test_nan_in_checkpoints_is_reported(tmp_path: Path, name: str) -> None:
    save_arrays(tmp_path / "layer.safetensors", {name: np.array([[1, np.nan, 2]], np.float32), "other": np.ones(2)})
    with pytest.raises(ReconstructionError, match=rf"layer\.safetensors: {name} holds 1 NaN values"):
        load_arrays(tmp_path / "layer.safetensors")


def test_report_of_wrong_types_is_refused(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text(json.dumps(dict.fromkeys(Report.__dataclass_fields__, "1")))
    with pytest.raises(Exception, match="not a report of this version"):
        Report.read(tmp_path / "report.json")
