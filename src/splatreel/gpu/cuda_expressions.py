"""Tokens, types and expressions of WGSL, which are read and written as C++."""

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
        """Start at the first token of a source."""
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
