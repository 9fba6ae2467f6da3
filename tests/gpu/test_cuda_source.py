"""The translation of kernels to CUDA C++. That the results are right is tested on an emulated GPU (test_drawing.py)."""

import re
from pathlib import Path

import pytest

from splatreel.base.errors import GpuError
from splatreel.gpu.cuda_libraries import Compiler, find_compilers
from splatreel.gpu.cuda_source import translate
from splatreel.gpu.device import complete_source, read_shader

SHADERS = Path("src/splatreel/gpu/shaders")
KERNELS = [path.stem for path in sorted(SHADERS.glob("*.wgsl")) if "fn main" in path.read_text()]
OPEN = {"forward": "DEPTHS", "backward": "DEPTHS", "gather": "DEPTHS", "adam_knots": "KIND"}
VALUES = {"DEPTHS": ("false", "true"), "KIND": ("0u", "1u", "2u")}
CHANNELS = {"FIRST": "1u", "END": "2u"}


def translated(text: str) -> str:
    """Return the translation without its line breaks and indentation."""
    return " ".join(translate(text).split())


@pytest.mark.parametrize(
    ("wgsl", "cuda"),
    [
        (
            "const A = 0.9; fn f() -> f32 { return 1.0 - A; }",
            "return 0.1f;",
        ),  # not the difference of two rounded numbers
        ("const A = 1.0 / 255.0;", "constexpr auto A = 0.003921569f;"),
        ("const A = -1e-4; fn f() -> f32 { return -A * 2.0; }", "return 0.0002f;"),
        ("const N = 4u; const M = N / 2u;", "constexpr auto M = N / 2u;"),
        ("const W = array<f32, 2>(0.5, 1.0);", "__constant__ float W[2] = {0.5f, 1.0f};"),
        ("var<workgroup> parts: array<array<f32, 8>, 6>;", "__shared__ float parts[6][8];"),
        ("var<workgroup> open: atomic<u32>;", "__shared__ unsigned open;"),
        ("struct S { a: vec3f, b: array<vec4u, 8>, }", "struct S { vec3f a; vec4u b[8]; };"),
        ("fn f() { var sums: array<f32, 7>; }", "float sums[7] = {};"),
        ("fn f(s: S) -> f32 { return s.place.xyz[1]; }", "return s.place.xyz()[1];"),
        ("fn f(a: f32) -> u32 { return bitcast<u32>(a) & 0x80000000u; }", "return as_u32(a) & 0x80000000u;"),
        ("fn f(a: i32) -> i32 { return a * (a + 3) - -a % 2; }", "return a * (a + 3) - -a % 2;"),
        (
            "fn f(a: bool, b: bool) { if (!a && b) { return; } else if (b) { } else { } }",
            "if ((!a && b)) { return; } else if",
        ),
        ("fn f() { for (; k < 4u; k++) { if (k == 2u) { continue; } break; } }", "for (; k < 4u; k++)"),
        (
            "fn f(b: u32) -> f32 { switch (b) { case 1u: { return 2.0; } default: { return 1.0; } } }",
            "case 1u: { return 2.0f; } break;",
        ),
    ],
)
def test_statements_and_declarations(wgsl: str, cuda: str) -> None:
    assert cuda in translated(wgsl)


def test_buffers_are_parameters_in_the_order_of_their_numbers() -> None:
    found = translated(
        """@group(0) @binding(2) var<storage, read_write> out: array<vec4f>;
        @group(0) @binding(0) var<uniform> draw: vec4u;
        @group(0) @binding(1) var<storage, read> list: array<atomic<u32>>;
        @compute @workgroup_size(GROUP) fn main(@builtin(local_invocation_index) local: u32) { out[local] = vec4f(0.0); }"""
    )
    parameters = re.search(r"entry\((.*?)\) \{", found)
    assert parameters is not None
    assert parameters[1] == (
        "const __grid_constant__ vec4u draw, const unsigned* __restrict__ list, vec4f* __restrict__ out"
    )
    assert "Kernel kernel{draw, list, out}; kernel.main(threadIdx.x);" in found


@pytest.mark.parametrize(
    ("wgsl", "message"),
    [
        ("fn f() { let short = 1u; }", "short is a word of C"),
        ("alias Number = f32;", "a declaration starts with alias"),
        ("fn f() { let a = 1u }", "; was expected near"),
        ("fn f() { let a = ; }", "an expression starts with ;"),
        ("fn f() {", "more was expected"),
    ],
)
def test_what_cannot_be_translated_is_named(wgsl: str, message: str) -> None:
    with pytest.raises(GpuError, match=message):
        translate(wgsl)


def sources(group: int, subgroups: bool) -> dict[str, str]:
    """Return the complete source of every kernel, with all values of what its file leaves open."""
    found = {}
    for name in KERNELS:
        label = OPEN.get(name)
        for value in VALUES[label] if label else ("",):
            constants = CHANNELS | ({label: value} if label else {})
            source = complete_source(name, group, subgroups, **constants)
            found[f"{name} {value}"] = read_shader("prelude.cu") + translate(source)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("capability", "group", "subgroups"), [(75, 64, True), (90, 64, False), (120, 256, True)])
def test_nvrtc_compiles_every_kernel(capability: int, group: int, subgroups: bool) -> None:
    """NVIDIA's compiler needs no GPU. Volta's instructions (70) are left out: the newest compilers do not know them."""
    compilers = find_compilers()
    if not compilers:
        pytest.skip("NVRTC is not installed: pip install nvidia-cuda-nvrtc")
    for file in compilers:
        compiler = Compiler(file)
        for name, source in sources(group, subgroups).items():
            assert len(compiler.compile(source, name, capability)) > 1000
        with pytest.raises(GpuError, match="Kernel wrong does not compile"):
            compiler.compile("__global__ void entry() { nonsense; }", "wrong", capability)
        ptx = compiler.compile('extern "C" __global__ void entry() {}', "newer", compiler.supported[-1] + 1)
        assert b".target" in ptx, "a device that the compiler does not know gets PTX"
        with pytest.raises(GpuError, match="and newer, the device has 1"):
            compiler.compile("", "old", 1)
