"""`--masks` and `--region` of the command line."""

import json
import shutil
from pathlib import Path

import pytest

from splatreel.cli.main import main
from splatreel.cli.options import CaptureOptions
from tests.golden import GOLDEN


@pytest.mark.parametrize("option", [["--masks", "masks"], ["--region", "sphere:0,0,0,1"], ["--set", "region=capture"]])
def test_captures_that_grow_have_no_subject(
    tmp_path: Path, option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reconstruct", str(tmp_path), "--out", str(tmp_path / "out"), "--follow", *option]) == 2
    assert "--masks and --region are for captures that are complete" in capsys.readouterr().err


def test_masks_are_a_part_of_how_a_capture_is_opened() -> None:
    assert CaptureOptions().source("scene", "masks").request["masks"] == "masks"
    assert "masks" not in CaptureOptions().source("scene").request


@pytest.mark.parametrize(
    ("record", "option"),
    [({"capture": {"masks": "abc"}}, "--masks"), ({"capture": {}, "config": {"region": "capture"}}, "--region")],
)
def test_reel_of_a_subject_is_not_compared_with_whole_images(
    tmp_path: Path, record: dict, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(GOLDEN, tmp_path / "reel")
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "run.json").write_text(json.dumps(record))
    assert main(["evaluate", str(tmp_path), str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert f"was reconstructed with {option}, so whole images cannot be compared" in capsys.readouterr().err
