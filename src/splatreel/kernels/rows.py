"""Arithmetic on rows of floats as LLVM vectors, for loops that LLVM's vectorizer handles badly.

The operators of `Row` append LLVM instructions to the function that numba is compiling. A row has 16 floats on processors with AVX-512,
else 8: one register of AVX2 or two of NEON.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import binding, ir
from numba import config, extending
from numba.core import cgutils, types
from numba.np import arrayobj

intrinsic: Any = extending.intrinsic  # typed as Any, because callers do not pass the typing context of its signature

FAST = ("fast",)
_FLOAT = ir.FloatType()


def lanes(context: Any) -> int:
    """Return the number of floats in a row for the processor that numba compiles for."""
    return 16 if "+avx512f" in _features(context) else 8


def _features(context: Any) -> str:
    """Return the processor features that numba compiles for, such as "+avx2,+avx512f".

    numba documents no way to ask for these. `magic_tuple` is the key of its cache, which ends with them. In a version of numba without
    it, the features are those of this processor. A row of either size is compiled to correct code on every processor.
    """
    try:
        features = context.codegen().magic_tuple()[-1]
    except (AttributeError, TypeError, IndexError):
        features = None
    if isinstance(features, str):
        return features
    chosen = getattr(config, "CPU_FEATURES", None)  # NUMBA_CPU_FEATURES
    return binding.get_host_cpu_features().flatten() if chosen is None else chosen


def _vector(width: int) -> Any:
    return ir.VectorType(_FLOAT, width)


def _declared(builder: Any, name: str, returned: Any, arguments: Sequence[Any]) -> Any:
    """Return an intrinsic function of LLVM, declared in the module that is being built."""
    found = builder.module.globals.get(name)
    return found or ir.Function(builder.module, ir.FunctionType(returned, arguments), name)


class Row:
    """A row of floats or booleans in a function that is being compiled."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder = builder
        self.value = value
        self.width = value.type.count

    def _other(self, other: Any) -> Any:
        if isinstance(other, Row):
            return other.value
        if isinstance(other, int | float):
            return _constant(other, self.width)
        return spread(self.builder, other, self.width).value

    def __add__(self, other: Any) -> Row:
        """Return the sum with a row or number."""
        return Row(self.builder, self.builder.fadd(self.value, self._other(other), flags=FAST))

    def __sub__(self, other: Any) -> Row:
        """Return the difference from a row or number."""
        return Row(self.builder, self.builder.fsub(self.value, self._other(other), flags=FAST))

    def __mul__(self, other: Any) -> Row:
        """Return the product with a row or number."""
        return Row(self.builder, self.builder.fmul(self.value, self._other(other), flags=FAST))

    def __truediv__(self, other: Any) -> Row:
        """Return the quotient by a row or number."""
        return Row(self.builder, self.builder.fdiv(self.value, self._other(other), flags=FAST))

    def __gt__(self, other: Any) -> Row:
        """Return booleans: whether each float is larger."""
        return Row(self.builder, self.builder.fcmp_ordered(">", self.value, self._other(other), flags=FAST))

    def __ge__(self, other: Any) -> Row:
        """Return booleans: whether each float is larger or equal."""
        return Row(self.builder, self.builder.fcmp_ordered(">=", self.value, self._other(other), flags=FAST))

    def __le__(self, other: Any) -> Row:
        """Return booleans: whether each float is smaller or equal."""
        return Row(self.builder, self.builder.fcmp_ordered("<=", self.value, self._other(other), flags=FAST))

    def __and__(self, other: Row) -> Row:
        """Return booleans that are true where both rows are."""
        return Row(self.builder, self.builder.and_(self.value, other.value))

    def where(self, yes: Any, no: Any) -> Row:
        """Return yes where this row of booleans is true, else no."""
        return Row(self.builder, self.builder.select(self.value, self._choice(yes), self._choice(no)))

    def _choice(self, value: Any) -> Any:
        return value.value if isinstance(value, Row) else _constant(value, self.width)

    def at_least(self, least: float) -> Row:
        """Return the larger of each float and a constant."""
        return (self > least).where(self, least)

    def at_most(self, most: float) -> Row:
        """Return the smaller of each float and a constant."""
        return (self <= most).where(self, most)

    def negative(self) -> Row:
        """Return minus the absolute value."""
        absolute = _declared(self.builder, f"llvm.fabs.v{self.width}f32", self.value.type, [self.value.type])
        return Row(self.builder, self.builder.fneg(self.builder.call(absolute, [self.value])))

    def any(self) -> Any:
        """Return whether any of the booleans is true, as an LLVM i1."""
        either = _declared(self.builder, f"llvm.vector.reduce.or.v{self.width}i1", ir.IntType(1), [self.value.type])
        return self.builder.call(either, [self.value])

    def sum(self) -> Any:
        """Return the sum of the floats, as an LLVM float."""
        add = _declared(self.builder, f"llvm.vector.reduce.fadd.v{self.width}f32", _FLOAT, [_FLOAT, self.value.type])
        return self.builder.call(add, [ir.Constant(_FLOAT, 0.0), self.value], fastmath=FAST)


def _constant(value: float, width: int) -> Any:
    return ir.Constant(_vector(width), [float(value)] * width)


def spread(builder: Any, scalar: Any, width: int) -> Row:
    """Return a row of copies of one LLVM float."""
    empty = ir.Constant(_vector(width), ir.Undefined)
    first = builder.insert_element(empty, scalar, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
    return Row(builder, builder.shuffle_vector(first, empty, zeros))


def counted(builder: Any, first: int, width: int) -> Row:
    """Return the row first, first + 1, ..."""
    return Row(builder, ir.Constant(_vector(width), [float(first + k) for k in range(width)]))


class Memory:
    """A float32 array in a function that is being compiled, read and written by rows. width: floats in a row."""

    def __init__(self, context: Any, builder: Any, kind: Any, array: Any) -> None:
        self.builder = builder
        self.data = context.make_array(kind)(context, builder, array).data
        self.width = lanes(context)

    def load(self, start: Any, ahead: int) -> Row:
        """Return the row that begins `ahead` floats after the LLVM integer start."""
        return Row(self.builder, self.builder.load(self._pointer(start, ahead), align=4))

    def store(self, start: Any, ahead: int, value: Row) -> None:
        """Write a row to the place that `load` reads with the same arguments."""
        self.builder.store(value.value, self._pointer(start, ahead), align=4)

    def _pointer(self, start: Any, ahead: int) -> Any:
        place = self.builder.add(start, ir.Constant(start.type, ahead))
        element = self.builder.gep(self.data, [place], inbounds=True)
        return self.builder.bitcast(element, _vector(self.width).as_pointer())


class Sums:
    """Running sums of rows. The compiler keeps them in registers if there are enough."""

    def __init__(self, builder: Any, count: int, width: int) -> None:
        self.builder = builder
        self.places = [cgutils.alloca_once(builder, _vector(width)) for _ in range(count)]
        for place in self.places:
            builder.store(_constant(0.0, width), place)

    def add(self, rows: Sequence[Row]) -> None:
        """Add a row to each sum."""
        for place, row in zip(self.places, rows, strict=True):
            self.builder.store((Row(self.builder, self.builder.load(place)) + row).value, place)

    def totals(self) -> list[Any]:
        """Return the totals of all sums, as LLVM floats."""
        return [Row(self.builder, self.builder.load(place)).sum() for place in self.places]


Body = Callable[..., Sequence[Any] | None]


def row_loop(integers: int, floats: int = 0, results: int = 0) -> Callable[[Body], Any]:
    """Decorate a function that builds LLVM code. The result can be called in numba code.

    It takes a float32 array, then numbers of int64 and float32 arguments, and returns a tuple of float32 results, or
    nothing.
    """

    def decorate(build: Body) -> Any:
        returned = types.UniTuple(types.float32, results) if results else types.void
        names = ", ".join(f"argument{k}" for k in range(1 + integers + floats))

        def typed(typing: Any, array: Any, *others: Any) -> Any:
            def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
                memory = Memory(context, builder, signature.args[0], values[0])
                found = build(builder, memory, *values[1:])
                return context.make_tuple(builder, returned, found) if found else context.get_dummy_value()

            return returned(array, *[types.int64] * integers, *[types.float32] * floats), generate

        # numba takes the number of arguments from the function's named parameters, so `exec` makes a function with that many
        space: dict[str, Any] = {"typed": typed}
        exec(f"def {build.__name__}(typing, {names}): return typed(typing, {names})", space)
        return intrinsic(space[build.__name__])

    return decorate


@intrinsic(prefer_literal=True)
def stack_floats(typing: Any, size: Any) -> Any:
    """Return an uninitialized float32 array on the stack, aligned to 64 bytes. It must not outlive the function. size: a constant."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        with builder.goto_entry_block():
            memory = builder.alloca(ir.ArrayType(_FLOAT, size.literal_value))
            memory.align = 64
        array = context.make_array(signature.return_type)(context, builder)
        data = builder.bitcast(memory, _FLOAT.as_pointer())
        length = context.get_constant(types.intp, size.literal_value)
        step = context.get_constant(types.intp, 4)
        arrayobj.populate_array(array, data, [length], [step], step, None)
        return array._getvalue()

    return types.Array(types.float32, 1, "C")(size), generate


@intrinsic
def prefetch(typing: Any, array: Any, row: Any) -> Any:
    """Ask the processor to fetch a row of a 2D array into its cache."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kind = signature.args[0]
        data = context.make_array(kind)(context, builder, values[0])
        columns = cgutils.unpack_tuple(builder, data.shape, 2)[1]
        element = builder.gep(data.data, [builder.mul(values[1], columns)])
        byte, word = ir.IntType(8).as_pointer(), ir.IntType(32)
        fetch = _declared(builder, "llvm.prefetch.p0", ir.VoidType(), [byte, word, word, word])
        read, keep, of_data = 0, 3, 1
        hints = [ir.Constant(word, hint) for hint in (read, keep, of_data)]
        builder.call(fetch, [builder.bitcast(element, byte), *hints])
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


@intrinsic
def choose(typing: Any, condition: Any, yes: Any, no: Any) -> Any:
    """Return one of two float32 numbers without a branch. A branch would prevent vector code."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.select(*values)

    return types.float32(types.boolean, types.float32, types.float32), generate
