"""The scripts `measure.py` and `oracle.py`, on a capture that is rendered on demand."""

import importlib.util
import json
import re
from pathlib import Path

import pytest
import tyro

import measure
import oracle
from splatreel.base.errors import UsageError
from splatreel.capture import opening
from splatreel.scene.reel_source import ReelSource
from tests.evaluation import scenes

SOURCE = ReelSource(0, ("cam03",))
OPENED = {"tables": None, "width": scenes.WIDTH, "scale": None, "frames": (0, 5), "held_out": ["cam03"]}
"""Arguments with which a capture is opened for a reel whose manifest has `SOURCE`."""


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> list[dict]:
    """Arguments that captures were opened with."""
    asked: list[dict] = []

    def open_capture(path: Path, **request: object) -> scenes.FilmedCapture:
        asked.append(request)
        return scenes.capture(path, ["cam03"])

    for module in (opening, oracle):
        monkeypatch.setattr(module, "open_capture", open_capture)
    return asked


def test_oracle_and_the_distance_of_a_reel(
    requests: list[dict], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes.write_reel(tmp_path / "run" / "reel", SOURCE)
    arguments = ["capture", "--out", str(tmp_path / "out"), "--every", "3", "--iterations", "6", "--device", "cpu"]
    tyro.cli(oracle.main, args=[*arguments, "--reel", str(tmp_path / "run"), "--hold-out", "cam03"])
    printed = capsys.readouterr().out
    assert printed.strip() == (tmp_path / "out" / "oracle.md").read_text().strip()
    assert requests == [OPENED]
    record = json.loads((tmp_path / "out" / "oracle.json").read_text())
    assert [frame["frame"] for frame in record["frames"]] == [0, 3]
    assert record["config"]["keyframe"]["first_iterations"] == 6
    assert record["reel"]["distance"]["whole"] < 0  # the reel is the truth, the oracle had six iterations


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"at": "0,99"}, "Frames [99] were asked for; capture has frames 0 to 4. Choose among these."),
        ({"every": 0}, "--every 0 is out of range. Choose 1 or more."),
        ({"iterations": -1}, "keyframe.first_iterations -1 is out of range. Choose 0 or more."),
        ({"at": "0:3"}, "--at '0:3': '0:3' is not a frame. Write numbers with commas between them, such as 0,14."),
    ],
)
def test_impossible_values_are_refused(requests: list[dict], options: dict, fault: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=re.escape(fault)):
        oracle.main(Path("capture"), out=tmp_path / "out", device="cpu", **options)
    assert not (tmp_path / "out").exists()


def test_bench_codec_of_a_run_writes_table_chart_and_record(
    requests: list[dict], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    points = measure.rate_distortion_points
    monkeypatch.setattr(
        measure, "rate_distortion_points", lambda sweep: points(sweep, ["predictive 1.2", "predictive 4"])
    )
    run, out = scenes.write_run(tmp_path / "run", SOURCE), tmp_path / "out"
    measure.app.cli(args=["codec", str(run), "capture", "--every", "5", "--out", str(out)])
    printed, warned = capsys.readouterr()
    assert printed.startswith((out / "codec.md").read_text().rstrip("\n"))
    assert "| predictive 4 |" in printed
    assert requests == [OPENED]
    if importlib.util.find_spec("matplotlib"):
        assert "<svg" in (out / "codec.svg").read_text()
    else:
        assert 'codec.svg was not drawn. Charts need matplotlib. Run\n  pip install "splatreel[plots]"' in warned
    assert len((out / "codec.jsonl").read_text().splitlines()) > 0


@pytest.mark.parametrize("wrong", [["run"], ["run", "capture", "--every", "0"]])
def test_bench_codec_of_a_run_needs_its_capture(wrong: list[str]) -> None:
    with pytest.raises(UsageError, match=r"measure\.py codec RUN needs the CAPTURE after it"):
        measure.app.cli(args=["codec", *wrong])
