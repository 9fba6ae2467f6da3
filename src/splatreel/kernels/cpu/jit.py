"""How every CPU kernel is compiled, and the float32 constants they share.

A float64 literal, or an int times a float32, would promote a whole expression to float64 and halve the vector width,
hence named float32 constants. Numba's on-disk cache watches only the file a kernel is in: after changing a constant here,
delete the `__pycache__` folders.
"""

import os
from typing import Any

import numpy as np
from numba.core import config
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import AnalysisPass, register_pass
from numba.core.typed_passes import AnnotateTypes

if not {"NUMBA_THREADING_LAYER", "NUMBA_THREADING_LAYER_PRIORITY"} & set(os.environ):
    # Numba takes TBB first where the system has it. Its workers spin while they wait, and kernels of a millisecond wait a lot:
    # most of the processor's time went there.
    config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]  # pyright: ignore[reportAttributeAccessIssue]


class _KernelLibrary(JITCodeLibrary):
    """The code of a kernel, whose parallel loops are its own.

    Numba compiles a loop as a function, by itself, and once more with the kernel, where fast math may come to another order of sums.
    Both have one name, and the process that compiled them calls the first; whoever reads the kernel from the cache has the second
    only. So the last bit depended on who had compiled a kernel, and a run that was continued in another process on that. Names that
    are internal make both processes call the second.
    """

    def _finalize_final_module(self) -> None:
        for function in self._final_module.functions:
            if "gufunc" in function.name and not function.is_declaration:
                function.linkage = "internal"
        super()._finalize_final_module()


@register_pass(mutates_CFG=False, analysis_only=True)
class _OwnLoops(AnalysisPass):
    _name = "own_loops"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:  # pyright: ignore[reportIncompatibleMethodOverride] - whether it changed anything
        state.library = _KernelLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return False


class _KernelCompiler(CompilerBase):
    """Numba's own steps, with a library of our kind."""

    def define_pipelines(self) -> list[Any]:
        steps = DefaultPassBuilder.define_nopython_pipeline(self.state)
        steps.add_pass_after(_OwnLoops, AnnotateTypes)
        steps.finalize()
        return [steps]


SERIAL: dict[str, Any] = {"fastmath": True, "cache": True, "error_model": "numpy"}
PARALLEL: dict[str, Any] = {**SERIAL, "parallel": True, "pipeline_class": _KernelCompiler}

F = np.float32
U = np.uint64  # index type: with signed indices LLVM cannot rule out wrap-around and silently stops vectorizing
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)


def finite(depths: np.ndarray) -> np.ndarray:
    """Depths with 1e30 in place of infinity, which fast math does not know; float32."""
    return np.minimum(np.ascontiguousarray(depths, np.float32), F(1e30))
