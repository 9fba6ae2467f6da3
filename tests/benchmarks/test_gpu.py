"""`make gpu`: all of the script, on the stand-in for a GPU."""

import importlib
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent.parent


@pytest.fixture
def gpu(benchmarks: Path) -> ModuleType:
    return importlib.import_module("gpu")


def lines(file: Path) -> dict[str, dict[str, Any]]:
    return {line["benchmark"]: line for line in map(json.loads, file.read_text(encoding="utf-8").splitlines())}


@pytest.mark.slow
def test_all_of_it_runs_on_the_stand_in(gpu: ModuleType, tmp_path: Path) -> None:
    pytest.importorskip("gsplat", reason="gsplat is not installed")
    results, film = tmp_path / "results.jsonl", tmp_path / "film"
    gpu.kitchen.film(gpu.TINY.kitchen).write(film, gpu.TINY.frames)
    command = [sys.executable, "benchmarks/gpu.py", "--standin", "--results", str(results), "--out", str(tmp_path)]
    command += ["--basketball", str(film), "--minutes", "30"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    found = lines(results)
    names = ("basketball standard", "basketball wgpu standard", "basketball paper", "kitchen standard", "kitchen paper")
    trainings = [f"gpu {name}" for name in names]
    first = [f"gpu {name}" for name in ("adapters", "compile", "tests", "parity", "wgpu tests", "iterations")]
    first += ["gpu drawing"]
    assert list(found) == first + trainings
    assert {line["device"] for line in found.values()} == {"stand-in"}
    assert not [line for line in found.values() if "failed" in line]
    assert " passed" in found["gpu tests"]["tests"]
    parts = found["gpu parity"]["largest_relative_difference"]
    assert {"means", "sh_rest"} <= set(parts)
    assert max(parts.values()) < 1e-4
    for name in (name for name in trainings if "wgpu" not in name):
        line = found[name]
        assert line["finished"]
        assert line["psnr_at"]
        assert line["gpu_memory_mb"] > 0
        assert line["seconds_a_frame"] > 0


@pytest.fixture
def bench(gpu: ModuleType, tmp_path: Path) -> Callable[[float], Any]:
    results = tmp_path / "results.jsonl"

    def made(seconds: float) -> Any:
        return gpu.Bench(time.monotonic() + seconds, None, tmp_path, results, "", gpu.TINY, "none", standin=True)

    return made


def fails(bench: Any, found: dict[str, Any], share: float) -> None:
    found["reached"] = share
    raise ValueError("out of luck")


def not_finite(bench: Any, found: dict[str, Any], share: float) -> None:
    found["ms"] = float("nan")


def works(bench: Any, found: dict[str, Any], share: float) -> None:
    found["ms"] = 1.5


def steps(monkeypatch: pytest.MonkeyPatch, gpu: ModuleType, usable: bool) -> None:
    monkeypatch.setattr(gpu, "STEPS", {"broken": fails, "odd": not_finite, "fine-paper": works})
    monkeypatch.setattr(gpu, "usable", lambda: usable)


def test_what_fails_is_recorded_and_the_rest_goes_on(
    gpu: ModuleType, bench: Callable[[float], Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    steps(monkeypatch, gpu, usable=True)
    assert gpu.run_steps(bench(60), ["broken", "odd", "fine-paper"])
    found = lines(tmp_path / "results.jsonl")
    assert found["gpu broken"]["failed"] == "ValueError: out of luck"
    assert found["gpu broken"]["reached"] == pytest.approx(60, abs=5)
    assert "nan" in found["gpu odd"]["failed"]
    assert found["gpu fine paper"]["ms"] == 1.5


def test_where_cuda_is_broken_the_rest_runs_in_a_new_process(
    gpu: ModuleType, bench: Callable[[float], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    steps(monkeypatch, gpu, usable=False)
    called: list[list[str]] = []
    monkeypatch.setattr(gpu.subprocess, "call", lambda command: called.append(command) or 0)
    assert gpu.run_steps(bench(60), ["broken", "odd", "fine-paper"])
    assert called[0][called[0].index("--steps") + 1] == "odd,fine-paper"
    assert 0.9 < float(called[0][called[0].index("--minutes") + 1]) <= 1


def test_without_gsplats_kernels_nothing_else_is_tried(
    gpu: ModuleType, bench: Callable[[float], Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(gpu, "STEPS", {"compile": fails, "kernels": works})
    assert gpu.run_steps(bench(60), ["compile", "kernels"])
    assert list(lines(tmp_path / "results.jsonl")) == ["gpu compile"]


def test_when_the_time_is_over_no_step_begins(
    gpu: ModuleType, bench: Callable[[float], Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    steps(monkeypatch, gpu, usable=True)
    assert not gpu.run_steps(bench(0), ["broken"])
    assert not (tmp_path / "results.jsonl").exists()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ({"standin": True}, 2, "--results FILE"),
        ({"steps": "drawing,dance"}, 2, "no step 'dance'"),
        ({}, 1, "PyTorch"),
    ],
)
def test_what_cannot_be_done_is_said(
    gpu: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: dict[str, Any],
    code: int,
    words: str,
) -> None:
    monkeypatch.setattr(gpu, "missing", lambda: "PyTorch finds no CUDA device.")
    with pytest.raises(SystemExit) as ended:
        gpu.main(**options)
    assert ended.value.code == code
    assert words in capsys.readouterr().err
