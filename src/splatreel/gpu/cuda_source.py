"""Translation of the kernels from WGSL to CUDA C++.

The kernels use a small part of WGSL, whose syntax is close to C++: only declarations, literals and attributes differ. The translator
reads a kernel once and writes the same statements. `shaders/prelude.cu` provides the vectors and built-in functions of WGSL.

Module-scope constants, structs and workgroup variables become globals. Functions become methods of a struct that holds the buffers, so
that helpers read buffers by their names, as in WGSL, and so that functions may call later ones.
"""

from __future__ import annotations

from typing import NamedTuple

from splatreel.base.errors import GpuError
from splatreel.gpu.cuda_expressions import ExpressionTranslator, Type

ENTRY = "entry"
"""Name of the kernel in the translated source."""
_ASSIGNMENTS = ("=", "+=", "-=", "*=", "/=", "%=")
_BUILTINS = {
    "workgroup_id": "vec3u(blockIdx.x, blockIdx.y, blockIdx.z)",
    "num_workgroups": "vec3u(gridDim.x, gridDim.y, gridDim.z)",
    "local_invocation_index": "threadIdx.x",
    "subgroup_invocation_id": "threadIdx.x % warpSize",
    "subgroup_id": "threadIdx.x / warpSize",
    "num_subgroups": "(blockDim.x + warpSize - 1u) / warpSize",
}


class Binding(NamedTuple):
    """A buffer of a kernel. kind: `uniform`, `storage, read` or `storage, read_write`."""

    number: int
    kind: str
    name: str
    type: Type


def translate(source: str) -> str:
    """Translate the complete source of a kernel, `kernel_source.complete_source`, to CUDA C++ that follows the prelude.

    Returns:
        Source with the entry point `ENTRY`. Its parameters are the buffers in the order of their numbers: uniforms by value, storage
        as pointers.

    Raises:
        GpuError: The source uses a part of WGSL that is not supported.
    """
    return _Translator(source).translate()


class _Translator(ExpressionTranslator):
    """Parser of declarations and statements."""

    def __init__(self, source: str) -> None:
        super().__init__(source)
        self._globals: list[str] = []
        self._structs: list[str] = []
        self._shared: list[str] = []
        self._functions: list[str] = []
        self._bindings: list[Binding] = []
        self._builtins: list[str] = []

    def translate(self) -> str:
        while self._place < len(self._tokens):
            self._declaration()
        bindings = sorted(self._bindings)
        members, parameters = [], []
        for _, kind, name, type_ in bindings:
            const = "" if kind == "storage, read_write" else "const "
            if kind == "uniform":
                members.append(f"    const {type_.before}& {name};")
                parameters.append(f"const __grid_constant__ {type_.before} {name}")
            else:
                members.append(f"    STORAGE({const}{type_.before}) {name};")
                parameters.append(f"{const}{type_.before}* __restrict__ {name}")
        names = ", ".join(binding.name for binding in bindings)
        entry = [
            f'extern "C" __global__ void __launch_bounds__(GROUP) {ENTRY}({", ".join(parameters)}) {{',
            f"    Kernel kernel{{{names}}};",
            f"    kernel.main({', '.join(self._builtins)});",
            "}",
        ]
        struct = ["struct Kernel {", *members, *self._functions, "};"]
        parts = (*self._globals, *self._structs, *self._shared, *struct, *entry)
        return "\n".join(("namespace wgsl {", *parts, "}  // namespace wgsl", ""))

    # Declarations

    def _declaration(self) -> None:
        attributes: dict[str, str] = {}
        while self._taken("@"):
            label = self._take()
            attributes[label] = self._argument() if self._next == "(" else ""
        word = self._take()
        if word == "const":
            self._constant()
        elif word == "struct":
            name = self._name()
            self._take("{")
            fields = self._list("}", lambda: self._typed().declare_field())
            self._structs.append(f"struct {name} {{ {' '.join(fields)} }};")
        elif word == "var":
            self._variable(attributes)
        elif word == "fn":
            self._function()
        elif word != ";":
            raise GpuError(f"A kernel cannot be translated to CUDA: a declaration starts with {word}.")

    def _argument(self) -> str:
        self._take("(")
        return "".join(self._list(")", lambda: self._expression().text))

    def _constant(self) -> None:
        name = self._name()
        self._take("=")
        if self._next == "array":
            self._take()
            type_ = self._array()
            self._take("(")
            values = self._list(")", lambda: self._expression().text)
            self._globals.append(f"__constant__ {type_.declare(name)} = {{{', '.join(values)}}};")
        else:
            text, value = self._expression()
            if value is not None:
                self._constants[name] = value
            self._globals.append(f"constexpr auto {name} = {text};")
        self._take(";")

    def _variable(self, attributes: dict[str, str]) -> None:
        self._take("<")
        kinds = [self._take()]
        while self._taken(","):
            kinds.append(self._take())
        self._take(">")
        name, type_ = self._typed()
        self._take(";")
        if kinds == ["workgroup"]:
            self._shared.append(f"__shared__ {type_.declare(name)};")
        else:
            self._bindings.append(Binding(int(attributes["binding"]), ", ".join(kinds), name, type_))

    def _function(self) -> None:
        name = self._name()
        self._take("(")
        parameters = self._list(")", self._parameter)
        result = "void"
        if self._taken("->"):
            result = self._type().before
        body = self._block("    ")
        self._functions.append(f"    FN {result} {name}({', '.join(parameters)}) {body}")

    def _parameter(self) -> str:
        if self._taken("@"):
            self._take("builtin")
            self._builtins.append(_BUILTINS[self._argument()])
        name, type_ = self._typed()
        return type_.declare(name)

    # Statements

    def _block(self, indent: str) -> str:
        self._take("{")
        lines = []
        while not self._taken("}"):
            lines.append(f"{indent}    {self._statement(indent + '    ')}")
        return "\n".join(("{", *lines, f"{indent}}}"))

    def _statement(self, indent: str) -> str:
        word = self._next
        if word == "{":
            return self._block(indent)
        if word in ("if", "while"):
            self._take()
            condition = self._expression().text
            text = f"{word} ({condition}) {self._block(indent)}"
            if word == "if" and self._taken("else"):
                text += f" else {self._statement(indent) if self._next == 'if' else self._block(indent)}"
            return text
        if word == "for":
            return self._loop(indent)
        if word == "switch":
            return self._switch(indent)
        if self._taken("return"):
            value = "" if self._next == ";" else f" {self._expression().text}"
            self._take(";")
            return f"return{value};"
        if word in ("break", "continue"):
            self._take()
            self._take(";")
            return f"{word};"
        text = self._simple()
        self._take(";")
        return f"{text};"

    def _simple(self) -> str:
        """Return a declaration, an assignment or a call, without its semicolon."""
        if self._next in ("let", "var"):
            const = "const " if self._take() == "let" else ""
            name, type_ = self._name(), Type("auto")
            if self._taken(":"):
                type_ = self._type()
            value = f"= {self._expression().text}" if self._taken("=") else "= {}"
            return f"{const}{type_.declare(name)} {value}"
        target = self._unary().text
        if self._taken("++"):
            return f"{target}++"
        if self._next in _ASSIGNMENTS:
            return f"{target} {self._take()} {self._expression().text}"
        return target

    def _loop(self, indent: str) -> str:
        self._take("for")
        self._take("(")
        start = "" if self._next == ";" else self._simple()
        self._take(";")
        condition = self._expression().text
        self._take(";")
        step = self._simple()
        self._take(")")
        return f"for ({start}; {condition}; {step}) {self._block(indent)}"

    def _switch(self, indent: str) -> str:
        self._take("switch")
        lines = [f"switch ({self._expression().text}) {{"]
        self._take("{")
        while not self._taken("}"):
            label = "default" if self._take() == "default" else f"case {self._expression().text}"
            self._take(":")
            lines.append(f"{indent}    {label}: {self._block(indent + '    ')} break;")
        return "\n".join((*lines, f"{indent}}}"))
