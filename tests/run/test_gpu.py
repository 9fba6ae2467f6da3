"""Reconstruction on CUDA with a stand-in for the GPU: tensors stay on one device, and iterations do not wait."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.base.progress import Silent
from splatreel.codec.verification import verify_reel
from splatreel.config import EncodeConfig
from splatreel.evaluation.uncompressed import uncompressed_frames
from splatreel.kernels import splat
from splatreel.kernels.image import render_image
from splatreel.method.deform.hashgrid import HashGrid
from splatreel.method.train.group_trainer import GroupTrainer
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.run import checkpoint
from splatreel.run.device_choice import pick_device
from splatreel.run.output.reencode import reencode
from splatreel.run.pipeline import Result, reconstruct
from tests.method.captures import WallCapture, blots
from tests.run.test_pipeline import CONFIG, FRAMES
from tests.standin.device import WAITS
from tests.standin.gpu import gpu, without_gsplat


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Counter[str]]]:
    """Return the number of waits for the device in each iteration, by trainer."""
    counts: dict[str, list[Counter[str]]] = {}
    for trainer in (KeyframeTrainer, GroupTrainer):
        counts[trainer.__name__] = counted = []

        def step(*arguments: Any, original: Any = trainer.step, counted: list[Counter[str]] = counted) -> Any:
            before = WAITS.copy()
            result = original(*arguments)
            counted.append(WAITS - before)
            return result

        monkeypatch.setattr(trainer, "step", step)
    return counts


def quality(result: Result, capture: WallCapture) -> float:
    """Return the PSNR before encoding, over all frames and cameras."""
    scenes, names, errors = uncompressed_frames(result.work, result.reel), [c.name for c in capture.cameras], []
    for frame in range(FRAMES):
        for camera, truth in zip(capture.cameras, capture.read(frame, 1, names)[0], strict=True):
            shown = render_image(scenes(frame), camera, near=capture.near or 0.01)
            errors.append(np.square(shown.clip(0, 1) - truth / 255).mean())
    return float(-10 * np.log10(np.mean(errors)))


@pytest.mark.slow
def test_run_on_a_gpu_is_as_one_on_the_cpu(tmp_path: Path, waits: dict[str, list[Counter[str]]]) -> None:
    capture = WallCapture(FRAMES)
    on_cpu = reconstruct(capture, tmp_path / "cpu", CONFIG, device="cpu")
    for counted in waits.values():
        counted.clear()
    with gpu():
        on_gpu = reconstruct(capture, tmp_path / "gpu", CONFIG)
    assert (on_cpu.device, on_gpu.device) == ("cpu", "cuda")
    assert verify_reel(on_gpu.reel).groups == 2
    assert quality(on_gpu, capture) == pytest.approx(quality(on_cpu, capture), abs=0.5)
    keyframe, group = waits["KeyframeTrainer"], waits["GroupTrainer"]
    first = CONFIG.keyframe.first_iterations
    assert not any(keyframe[:first])
    # Among static points, which of these the touched tiles hold is asked once; the first look of a view at them waits more often.
    assert {sum(waited.values()) for waited in keyframe[-4:]} == {1}
    waits_of_others = sorted(sum(waited.values()) for waited in group)[: -2 * len(capture.cameras)]
    assert Counter(waits_of_others)[1] >= len(waits_of_others) - 1  # points were made dynamic once


@pytest.mark.parametrize("device", ["cpu", "auto"])
def test_gpu_without_gsplat_is_left_alone(tmp_path: Path, device: str) -> None:
    with without_gsplat():
        result = reconstruct(WallCapture(FRAMES), tmp_path / "run", CONFIG, device=device)
        for kept in result.work.glob("group*/layer.safetensors"):  # so that encoding has to measure as well
            arrays = checkpoint.load_arrays(kept)
            checkpoint.save_arrays(kept, {name: value for name, value in arrays.items() if name != "importance"})
        reencode(result.work, tmp_path / "again", EncodeConfig(), pick_device(device), Silent())
    assert result.device == "cpu"
    assert verify_reel(result.reel).groups == verify_reel(tmp_path / "again").groups == 2


@pytest.mark.slow
def test_hash_grid_learns_the_same_on_a_gpu() -> None:
    generator = torch.Generator().manual_seed(0)
    means, wanted = torch.rand(40, 3, generator=generator), torch.rand(40, 3, generator=generator) / 10

    def learned(device: str) -> tuple[torch.Tensor, torch.Tensor]:
        places, target = means.to(device), wanted.to(device)
        model = HashGrid(places, 5, 1.0, 0)
        model.extend_to(4)
        for step in range(3):
            dx, dq = model.offsets(places, 2.5)
            (dx - target).square().sum().backward()
            model.step(step / 3)
        dx, dq = model.offsets(places, 2.5)
        return dx.detach().cpu(), dq.detach().cpu()

    expected = learned("cpu")
    with gpu():
        torch.testing.assert_close(learned("cuda"), expected, atol=1e-6, rtol=1e-3)


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_values_that_are_not_finite_are_found_where_nobody_waits_for_them(device: str) -> None:
    with gpu():
        points = TrainablePoints.from_gaussians(
            blots(5, [0, 0, 0], [1, 1, 1], 0.1, 0), default_rates(1.0), torch.device(device)
        )
        points.check()
        with torch.no_grad():
            points.means[2, 1] = torch.nan
        with pytest.raises(GaussiansError, match="means holds 1 values"):
            points.check()
        with pytest.raises(GaussiansError, match="means holds 1 values"):
            points.gaussians()


def test_gpu_that_does_not_train_is_asked_whether_values_are_finite() -> None:
    """So that training views, which are measured when a group is done, tell of offsets that are not."""
    with gpu():
        points = torch.full((2, 3), torch.nan, device="cuda", requires_grad=True)
        others = torch.ones(2, 4, device="cuda"), torch.ones(2, 3, device="cuda")
        pinhole = np.eye(4), np.eye(3), 32, 32
        splat.project(points, *others, *pinhole)
        with torch.no_grad(), pytest.raises(GaussiansError, match="means holds 6 values"):
            splat.project(points, *others, *pinhole)
