import csv
import importlib
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import UsageError
from splatreel.evaluation.metrics import psnr


@pytest.fixture
def scorer(benchmarks: Path) -> ModuleType:
    return importlib.import_module("authors_renders")


def write(folder: Path, names: list[str], shift: int = 0) -> list[np.ndarray]:
    """Write images of noise, brighter by `shift`, and return them as floats."""
    images = []
    for number, name in enumerate(names):
        image = np.random.default_rng(number).integers(0, 200, (24, 32, 3)).astype(np.uint8) + np.uint8(shift)
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(image).save(folder / name)
        images.append(image.astype(np.float32) / 255)
    return images


def lines(file: Path) -> dict[str, dict[str, str]]:
    with open(file, encoding="utf-8", newline="") as opened:
        return {row["image"]: row for row in csv.DictReader(opened)}


THEIRS: dict[str, Callable[[dict[str, float]], object]] = {
    "a list": lambda v: [{"image": f"{n}.png", "PSNR": p} for n, p in v.items()],
    "by frame": lambda v: {f"frame_{n}": {"PSNR": p} for n, p in v.items()},
    "per_view.json": lambda v: {"ours_30000": {"PSNR": {f"{n}.png": p for n, p in v.items()}}},
    "lists by metric": lambda v: {"PSNR": list(v.values()), "mean_psnr": 3},
    "a list in order": lambda v: {"frames": [{"frame": n, "PSNR": p} for n, p in v.items()]},
}


@pytest.mark.parametrize("form", THEIRS)
def test_their_metrics_stand_beside_ours(
    scorer: ModuleType, tmp_path: Path, form: str, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [f"{n:05d}.png" for n in range(3)]
    renders = write(tmp_path / "renders", names, 5)
    truth = write(tmp_path / "gt", names)
    (tmp_path / "m.json").write_text(json.dumps(THEIRS[form]({f"{n:05d}": 30.5 + n for n in range(3)})))
    scorer.main(tmp_path / "renders", tmp_path / "gt", metrics=tmp_path / "m.json", out=tmp_path / "o.csv", lpips=False)
    found = lines(tmp_path / "o.csv")
    for number in range(3):
        row = found[f"{number:05d}"]
        assert float(row["our PSNR"]) == pytest.approx(psnr(renders[number], truth[number]))
        assert float(row["their PSNR"]) == 30.5 + number
        assert 0.5 < float(row["our SSIM"]) <= 1
    said = capsys.readouterr().out
    assert "3 images, paired by name" in said
    assert "mean of 3" in said
    assert "31.5000" in said


def test_csv_and_images_paired_by_number(scorer: ModuleType, tmp_path: Path) -> None:
    write(tmp_path / "renders", [f"render_{n}.png" for n in range(2)], 5)
    write(tmp_path / "gt", [f"cam07/frame_{n:04d}.jpg" for n in range(3)])
    (tmp_path / "m.csv").write_text("frame,psnr,note\n0,29.5,a\n1,28.5,b\nmean,29,c\n")
    scorer.main(
        tmp_path / "renders", tmp_path / "gt" / "cam07", metrics=tmp_path / "m.csv", out=tmp_path / "o.csv", lpips=False
    )
    assert [row["their psnr"] for row in lines(tmp_path / "o.csv").values()] == ["29.5", "28.5"]


@pytest.mark.parametrize(
    ("names", "metrics", "message"),
    [
        (["a.png", "b.png"], "{}", "neither names nor numbers pair all images"),
        (["0.png", "7.png"], "{}", "neither names nor numbers pair all images"),
        (["0.png", "1.png"], "{}", "holds no metrics by image that are known"),
        (["0.png", "1.png"], '{"x": {"PSNR": 3}}', "Rename them"),
        (["0.png", "1.png"], "[" * 1000, "nested"),
        ([], "{}", "holds no images"),
    ],
)
def test_unclear_input_is_refused(
    scorer: ModuleType, tmp_path: Path, names: list[str], metrics: str, message: str
) -> None:
    (tmp_path / "renders").mkdir()
    write(tmp_path / "renders", names)
    write(tmp_path / "gt", ["0.png", "1.png"])
    (tmp_path / "m.json").write_text(metrics)
    with pytest.raises(UsageError, match=message):
        scorer.main(tmp_path / "renders", tmp_path / "gt", metrics=tmp_path / "m.json", lpips=False)


def test_sizes_must_agree(scorer: ModuleType, tmp_path: Path) -> None:
    write(tmp_path / "renders", ["0.png"])
    (tmp_path / "gt").mkdir()
    Image.new("RGB", (30, 24)).save(tmp_path / "gt" / "0.png")
    with pytest.raises(UsageError, match=r"is 32x24, but .* is 30x24"):
        scorer.main(tmp_path / "renders", tmp_path / "gt", lpips=False)
