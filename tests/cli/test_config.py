"""`splatreel config`, and --set, which changes the listed settings."""

import json
from pathlib import Path

import numpy as np
import pytest

from splatreel.cli.main import main
from splatreel.config import Config, preset
from splatreel.config.settings import parse_settings, settings
from tests.capture import folders
from tests.method.captures import WallCapture


def test_config_lists_every_setting_in_the_form_of_set(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config"]) == 0
    text = capsys.readouterr().out
    lines = [line.lstrip() for line in text.splitlines() if " = " in line]
    assert [line.partition(" = ")[0] for line in lines] == list(sorted_by_section())
    values = parse_settings([line.replace(" = ", "=") for line in lines])
    assert values == {name: setting.of(Config()) for name, setting in settings().items()}
    assert "group: Settings of the motion of dynamic points within a group (paper section 4.2)" in " ".join(
        text.split()
    )
    assert max(len(line) for line in text.splitlines()) <= 120


def sorted_by_section() -> list[str]:
    """Names of all settings, those outside of sections first."""
    return sorted(settings(), key=lambda name: "." in name)


def test_other_qualities_show_standard_values(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--quality", "paper"]) == 0
    text = capsys.readouterr().out
    assert "  group.iterations_per_frame = 400   (standard: 110)\n" in text
    assert "  group.lambda_arap = 0.01\n" in text


def test_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--quality", "draft", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["quality"] == "draft"
    assert set(found["settings"]) == set(settings())
    row = found["settings"]["keyframe.max_points"]
    assert row == {
        "value": preset("draft").keyframe.max_points,
        "takes": "a whole number, 1 or more",
        "doc": settings()["keyframe.max_points"].doc,
    }


def test_set_values_are_part_of_the_run_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, folder = WallCapture(2), tmp_path / "capture"
    folder.mkdir()
    for camera in source.cameras:
        folders.write_video(folder / f"{camera.name}.mp4", list(source.read(0, 2, [camera.name])[:, 0]))
    np.save(folder / "poses_bounds.npy", folders.llff(source.cameras))
    few = [
        "keyframe.first_iterations=4",
        "group.iterations_per_frame=2",
        "keyframe.sh_degree=0",
        "check_coverage=false",
    ]
    command = ["reconstruct", str(folder), "--out", str(tmp_path / "out"), "--device", "cpu"]
    command += [part for text in few for part in ("--set", text)]
    assert main(command) == 0
    record = json.loads((tmp_path / "out" / "work" / "run.json").read_text())
    assert record["config"]["keyframe"]["first_iterations"] == 4
    assert record["config"]["group"]["tracks"] is True
    capsys.readouterr()
    assert main([*command, "--set", "group.tracks=false"]) == 1
    assert "config.group.tracks is true there, false now" in capsys.readouterr().err
    assert main(command) == 0
