"""Kernels of the CPU on arrays, without autograd, for programs that run whole iterations (`method/train/cpu_program.py`)."""

from splatreel.kernels.cpu.adam import add_signs
from splatreel.kernels.cpu.binning import Bins, bin_splats
from splatreel.kernels.cpu.deform import DeformedPoints, ProjectedPoints
from splatreel.kernels.cpu.deform import backward as deform_gradient
from splatreel.kernels.cpu.deform import forward as deform
from splatreel.kernels.cpu.layered import loss_and_gradient as layered_loss
from splatreel.kernels.cpu.motion import arap, offsets, offsets_gradient, product_sum, spline
from splatreel.kernels.cpu.project import BLUR, FINE_BLUR, Pinhole
from splatreel.kernels.cpu.rasterize import backward as blend_gradient
from splatreel.kernels.cpu.rasterize import forward as blend
from splatreel.kernels.cpu.rasterize import no_gradient
from splatreel.kernels.cpu.similarity import loss_and_gradient as photometric_loss

__all__ = [
    "BLUR",
    "FINE_BLUR",
    "Bins",
    "DeformedPoints",
    "Pinhole",
    "ProjectedPoints",
    "add_signs",
    "arap",
    "bin_splats",
    "blend",
    "blend_gradient",
    "deform",
    "deform_gradient",
    "layered_loss",
    "no_gradient",
    "offsets",
    "offsets_gradient",
    "photometric_loss",
    "product_sum",
    "spline",
]
