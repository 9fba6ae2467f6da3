"""`splatreel capture masks`, and `--masks auto` of `reconstruct`."""

from pathlib import Path

import pytest

from splatreel.capture.masks import read_mask_record
from splatreel.cli.main import main
from tests.segmentation import scenes


def test_command_makes_masks_and_names_the_next_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = scenes.write_capture(tmp_path / "scene", 6)
    assert main(["capture", "masks", str(scene), "--out", str(tmp_path / "masks"), "--width", "64"]) == 0
    said = capsys.readouterr().out
    assert "masks of 6 cameras and 6 frames, 64 pixels wide" in said
    assert f"--masks {tmp_path / 'masks'} --out OUT" in said
    assert (read_mask_record(tmp_path / "masks") or {})["size"] == "64x48"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--clean-plate", "plates"], "--clean-plate is for --masks auto"),
        (["--masks", "auto", "--estimate"], "--estimate needs finished masks"),
        (["--masks", "auto", "--cluster", "auto"], "--masks auto makes masks on this machine only"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    tmp_path: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = scenes.write_capture(tmp_path / "scene", 1)
    assert main(["reconstruct", str(scene), "--out", str(tmp_path / "out"), *options]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out" / "masks").exists()
