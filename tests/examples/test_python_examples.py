"""The Python examples run and print what their readers expect."""

import json
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import splatreel
from tests.golden import GOLDEN
from tests.method.small import small
from toyroom.capture import make_capture

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(monkeypatch: pytest.MonkeyPatch, name: str, *arguments: object) -> None:
    """Run an example as `python examples/NAME ARGUMENTS` does."""
    path = str(EXAMPLES / name)
    monkeypatch.setattr(sys, "argv", [path, *map(str, arguments)])
    runpy.run_path(path, run_name="__main__")


def test_readme_lists_every_example() -> None:
    listed = re.findall(r"^\| \[([\w.-]+)/?\]", (EXAMPLES / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    present = [path.name for path in EXAMPLES.iterdir() if path.suffix == ".py" or path.is_dir()]
    assert sorted(listed) == sorted(name for name in present if name != "__pycache__")


def test_examples_import_public_names_only() -> None:
    """`docs/reference/index.md` says which modules these are."""
    imported = re.compile(r"^(?:from|import) (splatreel[\w.]*)", re.MULTILINE)
    found = {name for path in EXAMPLES.glob("*.py") for name in imported.findall(path.read_text(encoding="utf-8"))}
    assert found == {"splatreel", "splatreel.readers", "splatreel.training"}


def test_draw_reel(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(monkeypatch, "draw_reel.py", GOLDEN, "--seconds", 0.2, "--out", tmp_path / "picture.png")
    camera = splatreel.open_reel(GOLDEN).manifest.camera
    with Image.open(tmp_path / "picture.png") as image:
        assert image.size == (camera.width, camera.height)
        assert np.asarray(image).max() > 50
    assert "Gaussians at 0.2 s" in capsys.readouterr().out


def test_export_frames(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    run(monkeypatch, "export_frames.py", GOLDEN, "--out", tmp_path / "frames", "--every", 3)
    reel = splatreel.open_reel(GOLDEN)
    files = sorted((tmp_path / "frames").iterdir())
    assert [file.name for file in files] == [f"{frame:05}.ply" for frame in range(0, reel.frames, 3)]
    assert len(splatreel.read_ply(files[1])) == len(reel.at(3 / reel.fps))


def test_plot_bytes(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run(monkeypatch, "plot_bytes.py", GOLDEN)
    manifest = splatreel.open_reel(GOLDEN).manifest
    total = sum(entry.bytes for entry in (*manifest.layers, *manifest.groups))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[2] == f"{total / 1000:.1f}"
    assert lines[0].endswith("#" * 60)


def test_publish_site(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    run(monkeypatch, "publish_site.py", GOLDEN, "--out", tmp_path / "site", "--title", "Tom & Jerry")
    page = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert "<title>Tom &amp; Jerry</title>" in page
    for link in re.findall(r'src="([^"]+)"', page):
        assert (tmp_path / "site" / link).is_file(), link


def test_capture_reader(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = splatreel.open_capture(make_capture(tmp_path / "room", width=64, height=48, frames=2))
    folder, rig = tmp_path / "rig", []
    for camera in source.cameras:
        rig.append({"name": camera.name, "viewmat": camera.viewmat.tolist(), "K": camera.K.tolist()})
        (folder / camera.name).mkdir(parents=True)
        for frame in range(2):
            Image.fromarray(source.read(frame, 1, [camera.name])[0, 0]).save(folder / camera.name / f"{frame:04}.png")
    (folder / "rig.json").write_text(json.dumps(rig), encoding="utf-8")
    run(monkeypatch, "capture_reader.py", folder, "--width", 32)
    assert capsys.readouterr().out == f"{len(rig)} cameras, 2 frames of 32x24 pixels\n"


@pytest.mark.slow
def test_train_group(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run(monkeypatch, "train_group.py", "--iterations", 300)
    out = capsys.readouterr().out
    losses = [float(value) for value in re.findall(r"loss ([\d.]+)", out)]
    assert len(losses) == 6
    assert losses[-1] < 0.8 * losses[0]
    moved = re.search(r"moved by ([\d.]+) of 0.24", out)
    assert moved is not None
    assert 0.1 < float(moved[1]) < 0.3


@pytest.mark.slow
def test_own_loss(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run(monkeypatch, "own_loss.py", "--iterations", 150)
    without, found = (float(share) for share in re.findall(r"shortest axis ([\d.]+)", capsys.readouterr().out))
    assert found < 0.5 * without, "the Gaussians are flat"


@pytest.mark.slow
def test_own_loss_by_torch(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    monkeypatch.syspath_prepend(EXAMPLES)
    run(monkeypatch, "own_loss_torch.py", "--iterations", 100)
    losses = [float(value) for value in re.findall(r"loss ([\d.]+)", capsys.readouterr().out)]
    assert len(losses) == 2
    assert losses[1] < losses[0]


@pytest.mark.slow
def test_reconstruct_with_progress(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    capture = make_capture(tmp_path / "room", width=64, height=48, frames=4)
    monkeypatch.setattr(splatreel, "preset", lambda name: small(), raising=False)
    with caplog.at_level("INFO"):
        run(monkeypatch, "reconstruct_with_progress.py", capture, "--out", tmp_path / "out", "--frames", 4)
    assert splatreel.open_reel(tmp_path / "out" / "reel").frames == 4
    assert "100 %" in caplog.text
    assert "% of the run done)" in caplog.text
