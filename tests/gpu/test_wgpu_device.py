"""Errors of wgpu: a device that is really lost."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import GpuError
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.gpu.wgpu_device import WgpuGpu, WgpuRecording
from tests.gpu.devices import software_adapter
from tests.method.train.trainers import Notes, group_trainer, keyframe_trainer, make_images

CALLS: dict[str, Callable[[WgpuGpu, Any], object]] = {
    "uniform": lambda gpu, buffer: gpu.uniform(np.zeros(4, np.float32)),
    "zeros": lambda gpu, buffer: gpu.zeros(64),
    "write": lambda gpu, buffer: gpu.write(buffer, np.zeros(4, np.float32)),
    "read": lambda gpu, buffer: gpu.read(buffer, np.uint32, (4,)),
    "kernel": lambda gpu, buffer: gpu.kernel("scan_blocks"),
    "submit": lambda gpu, buffer: gpu.record().submit(),
    "run": lambda gpu, buffer: run(gpu, buffer),
}


def run(gpu: WgpuGpu, buffer: Any) -> None:
    recording = gpu.record()
    recording.clear(buffer, 0, 64)
    buffers = {"length": buffer, "values": buffer, "sums": buffer}
    recording.run_each(gpu.kernel("scan_blocks"), 4, buffers)
    recording.submit()


@pytest.mark.parametrize("call", CALLS)
def test_a_lost_device_is_a_gpu_error_wherever_it_is_noticed(call: str, caplog: pytest.LogCaptureFixture) -> None:
    gpu = WgpuGpu(software_adapter())
    buffer = gpu.zeros(64)
    gpu.device.destroy()
    with pytest.raises(GpuError) as raised:
        CALLS[call](gpu, buffer)
    assert str(raised.value) == f"{gpu.adapter.name}: the device was lost."
    assert raised.value.__cause__ is not None, "the cause keeps the text of wgpu"


@pytest.mark.parametrize(("kind", "number"), [("group", 20), ("group", 90), ("keyframe", 45)])
def test_training_continues_when_the_device_is_lost_between_two_calls(
    kind: str, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared, notes, calls = SharedGpu(software_adapter()), Notes(), []

    def destroying(original: Callable[..., Any]) -> Callable[..., Any]:
        def call(self: object, *arguments: Any, **named: Any) -> Any:
            calls.append(original)
            if len(calls) == number:
                shared.open().device.destroy()
            return original(self, *arguments, **named)

        return call

    gpu = shared.open()
    assert isinstance(gpu, WgpuGpu)
    for owner, name in ((WgpuGpu, "write"), (WgpuGpu, "read"), (WgpuGpu, "uniform"), (WgpuRecording, "run")):
        monkeypatch.setattr(owner, name, destroying(getattr(owner, name)))
    if kind == "group":
        group_trainer(shared).train(notes)
    else:
        keyframe_trainer(shared).train(make_images(1), 40, 40, notes)
    assert len(calls) >= number
    (note,) = (note for note in notes.notes if "the GPU failed" in note)
    assert f"({gpu.adapter.name}: the device was lost): training continues on the CPU" in note
