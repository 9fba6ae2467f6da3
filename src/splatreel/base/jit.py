"""Kernels: functions that numba compiles for one signature, caches on disk, and runs over ranges of items on all threads."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Protocol

import numba
import numpy as np
from numba import types

from splatreel.base import threads
from splatreel.base.process import check_address_space, choose_compile_cache

choose_compile_cache()
logger = logging.getLogger("splatreel")

FAST: dict[str, Any] = {"fastmath": True, "cache": True, "error_model": "numpy", "nogil": True}
"""Options for training and rendering kernels."""
EXACT: dict[str, Any] = {"cache": True, "error_model": "numpy", "nogil": True}
"""Options for the codec: without `fastmath`, because the format specifies the order of floating-point sums."""

_COMPILE_BYTES, _LOAD_BYTES = 256 << 20, 64 << 20
"""Virtual memory that LLVM may need to compile a kernel, or to load it."""

BOOL, INT, FLOAT, DOUBLE = types.boolean, types.int64, types.float32, types.float64
"""Scalar types of kernel arguments."""


class Warmup(Protocol):
    """Compiles kernels ahead of time in other processes."""

    def wait_for(self, kernel: str) -> None:
        """Wait until the kernel is in the cache. Return at once if this warmup will not compile it."""


_warmup: Warmup | None = None


def use_warmup(warmup: Warmup | None) -> None:
    """Make kernels wait for a warmup before they compile themselves. None: no warmup is running."""
    global _warmup
    _warmup = warmup


@cache
def announce_compilation() -> None:
    """Log, once in a process, that kernels are compiled now. Without a logging setup of the program, it is printed."""
    logger.warning("Compiling kernels for this processor. This happens once and takes up to a minute.")


def array(dtype: Any, dimensions: int) -> types.Array:
    """Return the type of a C-contiguous array argument."""
    return types.Array(numba.from_dtype(np.dtype(dtype)), dimensions, "C")


F1, F2, F3, F4 = (array(np.float32, dimensions) for dimensions in (1, 2, 3, 4))
D1 = array(np.float64, 1)
I1, I2 = array(np.int32, 1), array(np.int32, 2)
L1, L2, L3 = (array(np.int64, dimensions) for dimensions in (1, 2, 3))
B1, B2, B3 = (array(np.bool_, dimensions) for dimensions in (1, 2, 3))
U1, U2, U4 = (array(np.uint8, dimensions) for dimensions in (1, 2, 4))


class Kernel:
    """A function that numba compiles on the first call, for exactly one signature.

    Other argument types raise `TypeError` instead of compiling a second version.
    """

    def __init__(
        self, function: Callable[..., Any], signature: Sequence[types.Type], options: dict[str, Any], name: str = ""
    ) -> None:
        """Declare the kernel.

        Args:
            function: The function to compile.
            signature: Types of all arguments.
            options: Options of `numba.njit`.
            name: Name of the kernel in its module. "": the name of the function.
        """
        self.module = function.__module__
        self.name = f"{self.module.removeprefix('splatreel.')}.{name or function.__name__.strip('_')}"
        self.signature = tuple(signature)
        self.dispatcher: Any = numba.njit(**options)(function)
        self._lock = threading.Lock()
        self._call: Callable[..., Any] = self._compile_and_call

    def __call__(self, *arguments: Any) -> Any:
        """Run the kernel in this thread."""
        return self._call(*arguments)

    def over(self, count: int, *arguments: Any, grain: int = 1, chunks: int | None = None) -> None:
        """Run the kernel over 0..count on all threads: `kernel(first, last, *arguments)` for consecutive ranges.

        Args:
            count: Number of items.
            *arguments: The kernel's arguments after `first` and `last`.
            grain: Smallest number of items that is worth a thread.
            chunks: Number of ranges. None: one per thread.
        """
        if self._call != self.dispatcher:
            self.compile()
        threads.run_ranges(self.dispatcher, count, arguments, grain, chunks)

    def is_cached(self) -> bool:
        """Return whether numba's cache on disk seems to have the kernel. The names and dates of its files decide."""
        code = self.dispatcher.py_func.__code__
        index = f"{self.module.rsplit('.', 1)[-1]}.{self.dispatcher.py_func.__qualname__}-{code.co_firstlineno}."
        try:
            changed = os.stat(code.co_filename).st_mtime
            with os.scandir(self.dispatcher.stats.cache_path or "") as files:
                return any(
                    file.name.startswith(index) and file.name.endswith(".nbi") and file.stat().st_mtime >= changed
                    for file in files
                )
        except OSError:
            return False

    def needs_warmup(self) -> bool:
        """Return whether another process can compile the kernel for this one: there is a cache, and the kernel is not in it."""
        return self.dispatcher.stats.cache_path is not None and not self.is_cached()

    def compile(self) -> None:
        """Compile the kernel, or load it from the cache."""
        with self._lock:
            if not self.dispatcher.signatures:
                if _warmup is not None:
                    _warmup.wait_for(self.name)
                elif not self.is_cached():
                    announce_compilation()
                check_address_space(_LOAD_BYTES if self.is_cached() else _COMPILE_BYTES)
                self.dispatcher.compile(self.signature)
                self.dispatcher.disable_compile()
            self._call = self.dispatcher

    def _compile_and_call(self, *arguments: Any) -> Any:
        self.compile()
        return self.dispatcher(*arguments)


def kernel(
    *signature: types.Type, options: dict[str, Any] | None = None, name: str = ""
) -> Callable[[Callable[..., Any]], Kernel]:
    """Decorate a function that is called directly, not over ranges.

    Args:
        *signature: Types of all arguments.
        options: Options of `numba.njit`. None: `FAST`.
        name: Name of the kernel in its module. "": the name of the function.
    """
    return lambda function: Kernel(function, signature, FAST if options is None else options, name)


def range_kernel(
    *signature: types.Type, allocates: bool = False, name: str = ""
) -> Callable[[Callable[..., Any]], Kernel]:
    """Decorate a function `function(first, last, *arguments)` over independent items, for `Kernel.over`.

    An item must not write memory that other items read or write. Then the result does not depend on the number of threads.

    Args:
        *signature: Types of the arguments after `first` and `last`.
        allocates: Whether the function makes arrays. If not, numba leaves out reference counting, which is slow.
        name: Name of the kernel in its module. "": the name of the function.
    """
    return kernel(INT, INT, *signature, options=FAST if allocates else FAST | {"_nrt": False}, name=name)
