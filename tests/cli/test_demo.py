"""The main job, whole, on a capture so small that it is quick: film, reconstruct, encode, evaluate, continue."""

import dataclasses
import json
from pathlib import Path

import pytest

from splatreel.cli import demo
from splatreel.cli.main import main
from splatreel.cli.options import with_set
from splatreel.config import preset
from splatreel.run import groups
from tests.method.small import small


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"keyframe.first_iterations": 150, "keyframe.refine_iterations": 20, "keyframe.max_points": 3000}
    config = small({**few, "keyframe.sh_degree": 3, "group.length": 4, "group.iterations_per_frame": 5})
    monkeypatch.setattr(demo, "configure", lambda *_: config)


def test_demo_makes_no_trial_of_novel_views_by_default() -> None:
    config = demo.demo_config("standard", 3)
    assert (config.seed, config.check_coverage) == (3, False)
    assert dataclasses.replace(config, check_coverage=True) == dataclasses.replace(preset("standard"), seed=3)
    assert with_set(config, ("check_coverage=true",)).check_coverage


@pytest.mark.slow
@pytest.mark.smoke
def test_demo_makes_a_reel_and_a_report_and_is_continued(
    tiny: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(groups, "FIRST_AFTER", 0.0)
    arguments = ["demo", "--out", str(tmp_path / "demo"), "--width", "64", "--height", "48", "--frames", "8"]
    assert main(arguments) == 0
    said = capsys.readouterr()
    report = json.loads((tmp_path / "demo" / "report.json").read_text())
    manifest = json.loads((tmp_path / "demo" / "reel" / "manifest.json").read_text())
    assert (report["frames"], report["width"], report["height"]) == (8, 64, 48)
    assert report["psnr"] > 18  # about 21.7; the mean color alone has 13.7
    assert report["psnr"] == pytest.approx(report["psnr_undecoded"], abs=0.5)
    assert report["peak_memory_bytes"] > 0
    assert {"capture", "keyframe", "group", "encode", "evaluate"} <= set(report["seconds"])
    assert [c["name"] for c in report["cameras"]] == ["cam00", "cam07"]
    assert len(manifest["groups"]) == 2
    assert manifest["live"] is False
    assert manifest["title"] == "A toy room"
    assert {"poster", "thumbnails", "sound", "limits"} <= set(manifest)
    assert "Sound: camera cam" in said.err
    assert "splatreel serve" in said.out  # no terminal here: it ends by itself
    named = [
        line.split(": ")[1] for line in said.out.splitlines() if line.startswith(("Report: ", "Images ", "Reel: "))
    ]
    assert len(named) == 3
    assert all(Path(path).exists() for path in named)
    assert "Your own reel is being made now" in said.out
    assert "Watch your own reel, first its keyframe, later moving: http://127.0.0.1:" in said.err
    assert said.err.count("training the first keyframe: ") == 1, "one line per stage"
    assert not (tmp_path / "demo" / "work" / "preview").exists()

    assert main(["edit", str(tmp_path / "demo"), "--title", "My room"]) == 0
    assert main(arguments) == 0
    assert json.loads((tmp_path / "demo" / "reel" / "manifest.json").read_text())["title"] == "My room"
    again = json.loads((tmp_path / "demo" / "report.json").read_text())
    assert again["psnr"] == report["psnr"]
    assert "keyframe:" not in capsys.readouterr().err
    assert main(["verify", str(tmp_path / "demo")]) == 0
