"""Machine code of hot kernels, compiled here for several processors: it must consist of vector instructions."""

import json
import os
import subprocess
import sys

import pytest

AVX2 = "+avx,+avx2,+fma,+bmi,+bmi2,+f16c,+lzcnt,+popcnt,+movbe,+sse4.2"
AVX512 = AVX2 + ",+avx512f,+avx512bw,+avx512cd,+avx512dq,+avx512vl"
PROCESSORS = {
    "haswell": AVX2,
    "znver3": AVX2,
    "skylake-avx512": AVX512,
    "aarch64": "",
}
PROGRAM = """
import json, re, sys
import llvmlite.binding as llvm
import numba
from splatreel.kernels import blending, deform, project

def assembly(kernel):
    options = {name: kernel.dispatcher.targetoptions[name] for name in ("fastmath", "error_model", "nogil", "nrt") if
               name in kernel.dispatcher.targetoptions}
    options = {("_nrt" if name == "nrt" else name): value for name, value in options.items()}
    fresh = numba.njit(**options)(kernel.dispatcher.py_func)
    fresh.compile(kernel.signature)
    (code,) = (fresh.inspect_llvm() if sys.argv[1] == "aarch64" else fresh.inspect_asm()).values()
    return for_arm(code) if sys.argv[1] == "aarch64" else code

def for_arm(code):
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    code = re.sub(r"target (triple|datalayout) = .*", "", code)
    code = re.sub(r"define [^\\n]*@(NRT_\\w+)\\(.*?\\n}", r"declare void @\\1(ptr)", code, flags=re.S)  # these use x86 instructions
    module = llvm.parse_assembly(code)
    machine = llvm.Target.from_triple("aarch64-unknown-linux-gnu").create_target_machine(opt=3, cpu="neoverse-n1")
    return machine.emit_assembly(module)

def share(code):
    if sys.argv[1] == "aarch64":
        vectors = len(re.findall(r"\\tf(?:mul|add|sub|mla|mls|max\\w*|min\\w*)\\tv\\d+\\.4s", code))
        scalars = len(re.findall(r"\\tf(?:mul|add|sub|madd|msub|max\\w*|min\\w*)\\ts\\d+", code))
        return vectors / (vectors + scalars)
    lines = re.findall(r"\\tv(?:mul|add|sub|min|max|fn?m(?:add|sub)\\d+)[ps]s\\t.*", code)
    return sum("ymm" in line or "zmm" in line for line in lines) / len(lines)

kernels = (blending.forward, blending.backward, blending.gather, project._forward, project._backward, deform._deform,
           deform._deform_backward)
print(json.dumps({kernel.name: share(assembly(kernel)) for kernel in kernels}))
"""


@pytest.mark.slow
@pytest.mark.parametrize("processor", PROCESSORS)
def test_hot_kernels_are_vector_code(processor: str) -> None:
    """More than half of the single-precision arithmetic instructions are vector instructions."""
    environment = dict(os.environ)
    if processor != "aarch64":
        environment |= {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": PROCESSORS[processor]}
    else:
        environment |= {"NUMBA_CPU_NAME": "znver3", "NUMBA_CPU_FEATURES": AVX2}  # rows of 8 floats, as on aarch64
    command = [sys.executable, "-c", PROGRAM, processor]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr[-2000:]
    shares = json.loads(ran.stdout)
    assert len(shares) == 7
    assert min(shares.values()) > 0.4, shares
