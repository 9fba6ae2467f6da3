"""Translation of the kernels from WGSL to CUDA C++.

The kernels use a small part of WGSL, whose syntax is close to C++: only declarations, literals and attributes differ. The translator
reads a kernel once and writes the same statements. `shaders/prelude.cu` provides the vectors and built-in functions of WGSL.

Module-scope constants, structs and workgroup variables become globals. Functions become methods of a struct that holds the buffers, so
that helpers read buffers by their names, as in WGSL, and so that functions may call later ones.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from splatreel.base.errors import GpuError

_TOKEN = re.compile(
    r"//[^\n]*|\s+|(?P<token>0x[0-9a-fA-F]+u?|(?:\d+\.\d*|\.\d+)(?:e[-+]?\d+)?|\d+e[-+]?\d+|\d+u?|[A-Za-z_]\w*|->|\+\+"
    r"|[-+*/%]=|[=!<>]=|&&|\|\||.)",
    re.DOTALL,
)
_SWIZZLE = re.compile(r"[xyzw]{2,4}")
_SCALARS = {"f32": "float", "u32": "unsigned", "i32": "int"}
_PRECEDENCE = {
    "||": 1,
    "&&": 2,
    "|": 3,
    "&": 4,
    "==": 5,
    "!=": 5,
    "<": 6,
    ">": 6,
    "<=": 6,
    ">=": 6,
    "+": 7,
    "-": 7,
    "*": 8,
    "/": 8,
    "%": 8,
}
_RESERVED = re.compile(
    "asm|auto|char|class|delete|double|enum|explicit|extern|float|friend|goto|inline|int|long|mutable|namespace|new|operator|private"
    "|protected|public|register|short|signed|sizeof|static|template|this|throw|try|typedef|typename|union|unsigned|using|virtual|volatile"
)
"""Words of C++ that WGSL allows as names."""
_FOLDED: dict[str, Callable[[float, float], float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
}


class Expression(NamedTuple):
    """An expression. value: that of an expression of floating-point constants, which WGSL computes in double precision."""

    text: str
    value: float | None = None


class Type(NamedTuple):
    """A type as C++ declares it: `before NAME after`. Arrays of unknown length have the suffix `[]`."""

    before: str
    after: str = ""

    def declare(self, name: str) -> str:
        """Return the declaration of a name."""
        return f"{self.before} {name}{self.after}"


class Field(NamedTuple):
    """A name with its type."""

    name: str
    type: Type

    def declare_field(self) -> str:
        """Return the declaration in a struct."""
        return f"{self.type.declare(self.name)};"


class ExpressionTranslator:
    """Recursive-descent parser of types and expressions, which writes C++ while it reads WGSL."""

    def __init__(self, source: str) -> None:
        self._tokens = [found["token"] for found in _TOKEN.finditer(source) if found["token"]]
        self._place = 0
        self._constants: dict[str, float] = {}

    # Tokens

    @property
    def _next(self) -> str:
        return self._tokens[self._place] if self._place < len(self._tokens) else ""

    def _take(self, expected: str = "") -> str:
        token = self._next
        if not token or (expected and token != expected):
            near = " ".join(self._tokens[max(self._place - 8, 0) : self._place + 4])
            raise GpuError(f"A kernel cannot be translated to CUDA: {expected or 'more'} was expected near `{near}`.")
        self._place += 1
        return token

    def _taken(self, token: str) -> bool:
        if self._next != token:
            return False
        self._place += 1
        return True

    def _name(self) -> str:
        name = self._take()
        if _RESERVED.fullmatch(name):
            raise GpuError(f"A kernel cannot be translated to CUDA: {name} is a word of C++.")
        return name

    def _list(self, end: str, item: Callable[[], str]) -> list[str]:
        """Return items up to a closing token, separated by commas, of which the last one may be followed by one."""
        found = []
        while not self._taken(end):
            found.append(item())
            if not self._taken(","):
                self._take(end)
                break
        return found

    # Types

    def _typed(self) -> Field:
        name = self._name()
        self._take(":")
        return Field(name, self._type())

    def _type(self) -> Type:
        name = self._take()
        if name == "array":
            return self._array()
        if name == "atomic":
            self._take("<")
            inner = self._type()
            self._take(">")
            return inner
        return Type(_SCALARS.get(name, name))

    def _array(self) -> Type:
        self._take("<")
        inner, length = self._type(), ""
        if self._taken(","):
            length = f"[{self._expression(_PRECEDENCE['+']).text}]"
        self._take(">")
        return Type(inner.before, length + inner.after)

    # Expressions

    def _expression(self, least: int = 1) -> Expression:
        left = self._unary()
        while _PRECEDENCE.get(self._next, 0) >= least:
            sign = self._take()
            right = self._expression(_PRECEDENCE[sign] + 1)
            if left.value is not None and right.value is not None and sign in _FOLDED:
                value = _FOLDED[sign](left.value, right.value)
                left = Expression(_literal(value), value)
            else:
                left = Expression(f"{left.text} {sign} {right.text}")
        return left

    def _unary(self) -> Expression:
        for sign in ("-", "!", "~", "&"):
            if self._taken(sign):
                text, value = self._unary()
                negative = None if value is None or sign != "-" else -value
                return Expression(f"{sign}{text}", negative)
        return self._postfix(self._primary())

    def _postfix(self, found: Expression) -> Expression:
        text, value = found
        while self._next in (".", "["):
            value = None
            if self._taken("["):
                text += f"[{self._expression().text}]"
                self._take("]")
            else:
                self._take(".")
                field = self._name()
                text += f".{field}()" if _SWIZZLE.fullmatch(field) else f".{field}"
        return Expression(text, value)

    def _primary(self) -> Expression:
        if self._taken("("):
            text, value = self._expression()
            self._take(")")
            return Expression(f"({text})", value)
        token = self._take()
        if token[0].isdigit() or token[0] == ".":
            is_float = not token.startswith("0x") and ("." in token or "e" in token)
            return Expression(_literal(float(token)), float(token)) if is_float else Expression(token)
        if not (token[0].isalpha() or token[0] == "_"):
            raise GpuError(f"A kernel cannot be translated to CUDA: an expression starts with {token}.")
        if token == "bitcast":
            self._take("<")
            token = f"as_{self._take()}"
            self._take(">")
        if self._taken("("):
            arguments = ", ".join(self._list(")", lambda: self._expression().text))
            return Expression(f"{_SCALARS.get(token, token)}({arguments})")
        return Expression(token, self._constants.get(token))


def _literal(value: float) -> str:
    """Return a literal of single precision."""
    text = str(np.float32(value))
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"


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
    """Translate the complete source of a kernel, `device.complete_source`, to CUDA C++ that follows the prelude.

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
