"""The GPU through PyTorch and gsplat: whether it is there, and its programs."""

from __future__ import annotations

import numpy as np
import torch

from splatreel.gpu.adapters import Adapter
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.gsplat import program
from splatreel.gsplat.drawing import Lens, rasterize, splats_of
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.train.programs import GroupState, KeyframeState, terms_without_kernels
from splatreel.method.train.render import View
from splatreel.method.train.trainable_points import to_params
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

INTERFACE = "CUDA with gsplat"


class GsplatGpu:
    """An NVIDIA GPU of PyTorch whose programs call gsplat."""

    def __init__(self) -> None:
        self.device = torch.device("cuda")

    def unsupported(self, state: GroupState | KeyframeState) -> str | None:
        """Return why the programs cannot train a state; None if they can."""
        of_group = isinstance(state, GroupState)
        if of_group and not isinstance(state.points.deformation, Trajectory):
            return "the hash grid runs on the CPU"
        known = program.GROUP_TERMS if of_group else program.KEYFRAME_TERMS
        others = [term.name for term in state.losses if type(term) not in known]
        if others:
            return f"the programs of gsplat do not compute the loss {', '.join(others)}"
        return terms_without_kernels(state.losses)

    def group_program(self, state: GroupState) -> program.GsplatGroupProgram:
        """Return the program of a group."""
        return program.GsplatGroupProgram(self.device, state)

    def keyframe_program(self, state: KeyframeState) -> program.GsplatKeyframeProgram:
        """Return the program of a keyframe."""
        return program.GsplatKeyframeProgram(self.device, state)


def shared_gpu() -> SharedGpu:
    """Return the GPU of PyTorch, for the trainings of this process."""
    name = torch.cuda.get_device_name()
    return SharedGpu(Adapter(name, INTERFACE, "DiscreteGPU", {}, True, None), lambda _: GsplatGpu(), "cuda")


def draw(
    gaussians: Gaussians, camera: Camera, near: float, antialias: bool, background: tuple[float, float, float]
) -> np.ndarray:
    """Render for playback, see `play.renderers.Draw`."""
    points = [torch.tensor(array, device="cuda") for array in to_params(gaussians).values()]
    view = View.of(camera, antialias=antialias)
    pose, K, center = (torch.tensor(array, device="cuda") for array in (view.viewmat, view.K, view.center))
    lens = Lens(pose, K, center, view.width, view.height, antialias, 0.0, None, None)
    with torch.no_grad():
        image, alpha = rasterize(splats_of(points, None, None, lens, near), lens)
        behind = (1 - alpha[..., None]) * torch.tensor(background, device="cuda")
    return (image + behind).cpu().numpy()
