"""Kernels of the CPU on arrays, without autograd, for programs that run whole iterations (`method/train/cpu_group.py`)."""

from splatreel.kernels.cpu.adam import add_signs
from splatreel.kernels.cpu.binning import bin_splats
from splatreel.kernels.cpu.deform import DeformedPoints, ProjectedPoints
from splatreel.kernels.cpu.deform import backward as deform_gradient
from splatreel.kernels.cpu.deform import forward as deform
from splatreel.kernels.cpu.layered import loss_and_gradient
from splatreel.kernels.cpu.motion import arap, offsets, offsets_gradient, product_sum, spline
from splatreel.kernels.cpu.project import BLUR, FINE_BLUR, Pinhole

__all__ = [
    "BLUR",
    "FINE_BLUR",
    "DeformedPoints",
    "Pinhole",
    "ProjectedPoints",
    "add_signs",
    "arap",
    "bin_splats",
    "deform",
    "deform_gradient",
    "loss_and_gradient",
    "offsets",
    "offsets_gradient",
    "product_sum",
    "spline",
]
