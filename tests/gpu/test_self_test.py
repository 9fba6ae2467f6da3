"""The test of an opened GPU finds a device, a driver or a compiler that computes something else."""

import numpy as np
import pytest

from splatreel.base.errors import GpuError
from splatreel.gpu import device, self_test
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.gpu.wgpu_device import WgpuGpu
from tests.gpu.devices import software_adapter, software_gpu
from tests.method.train.trainers import Notes, keyframe_trainer, make_images

FAULTS = {
    "scan_add": ("+=", "-=", "sums"),
    "sort": ("if (count < 2u) { return; }", "if (count > 1024u) { return; }", "order of splats"),
    "forward": ("1.0 - through[p])", "through[p])", "picture"),
    "project": ("- lost", "+ 1e-3 * square", "picture"),
    "backward_subgroups": ("k < subgroups", "k < subgroups - 1u", "gradients"),
}
"""Faults of kernels: text, its replacement, and what the test finds."""


def change_kernel(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    read = device.read_shader

    def read_changed(file: str) -> str:
        source = read(file)
        if file != name:
            return source
        assert FAULTS[name][0] in source
        return source.replace(*FAULTS[name][:2])

    monkeypatch.setattr(device, "read_shader", read_changed)


def test_a_sound_device_passes() -> None:
    self_test.check_device(software_gpu())


@pytest.mark.parametrize("name", FAULTS)
def test_faults_of_kernels_are_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    change_kernel(monkeypatch, name)
    gpu = WgpuGpu(software_adapter())
    if name == "backward_subgroups" and not gpu.subgroups:
        pytest.skip("the adapter has no subgroups")
    with pytest.raises(GpuError, match=rf"{gpu.adapter.name.split()[0]}.*: a test of its {FAULTS[name][2]} failed\."):
        self_test.check_device(gpu)


def test_the_scene_fills_a_tile_beyond_shared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    gpu, counts = software_gpu(), []
    read = gpu.read

    def read_noting(buffer: object, dtype: type, shape: tuple[int, ...]) -> np.ndarray:
        counts.append(read(buffer, dtype, shape))
        return counts[-1]

    monkeypatch.setattr(gpu, "read", read_noting)
    self_test.check_device(gpu)
    pairs = np.diff(counts[1])  # of tiles
    assert pairs.max() > 1024
    assert pairs.min() < 100


def test_training_continues_on_the_cpu_with_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    change_kernel(monkeypatch, "forward")
    notes = Notes()
    keyframe_trainer(SharedGpu(software_adapter())).train(make_images(1), 40, 40, notes)
    assert any("a test of its picture failed): training continues on the CPU" in note for note in notes.notes)
