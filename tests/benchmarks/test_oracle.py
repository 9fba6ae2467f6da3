import importlib.util
import sys
from pathlib import Path

import pytest

from bench.oracle_report import OracleReport, Score, SingleFrame
from splatreel.evaluation.evaluate import Quality

FOLDER = Path(__file__).parent.parent.parent / "benchmarks"
FRAMES = [
    SingleFrame(0, Score(Quality(30, 31, 0.9), None), Quality(29, 30, 0.89), 100, 1180, 10.0, "cpu"),
    SingleFrame(9, Score(Quality(34, 35, 0.9), Quality(28, 29, 0.8)), Quality(33, 34, 0.93), 300, 2596, 20.5, "cpu"),
]


def test_a_record_pairs_the_bytes_with_what_they_decode_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.delitem(sys.modules, "record", raising=False)
    spec = importlib.util.spec_from_file_location("benchmark_oracle", FOLDER / "oracle.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    values = module.summary(OracleReport(FRAMES, []), sh_degree=3)
    assert (values["psnr"], values["psnr_undecoded"], values["psnr_moving_undecoded"]) == (31, 32, 28)
    assert (values["reel_bytes"], values["points"], values["seconds_total"]) == (3776, 200, 30.5)
    assert values["share_of_float32"] == 0.04  # 59 numbers of 4 bytes a point
    assert values["at"] == [0, 9]
    assert "distance" not in values
    assert module.summary(OracleReport(FRAMES, [f.score for f in FRAMES]), 3)["distance"] == {"whole": 0, "moving": 0}
