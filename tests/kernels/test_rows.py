"""The width of rows, which follows from the processor features that numba compiles for."""

from types import SimpleNamespace
from typing import Any

import pytest
from numba import config
from numba.core.registry import cpu_target

from splatreel.kernels.rows import _features, lanes

CONTEXT = cpu_target.target_context


def context(**codegen: Any) -> Any:
    """A compilation of another version of numba, whose code generator has these methods only."""
    return SimpleNamespace(codegen=lambda: SimpleNamespace(**codegen))


@pytest.mark.parametrize(
    "codegen",
    [{}, {"magic_tuple": None}, {"magic_tuple": lambda: ()}, {"magic_tuple": lambda: ("x86_64", "znver3", None)}],
    ids=["missing", "no method", "empty", "no text"],
)
def test_versions_of_numba_without_features_use_those_of_the_processor(codegen: dict[str, Any]) -> None:
    assert lanes(context(**codegen)) == lanes(CONTEXT)


def test_features_are_those_that_numba_compiles_for() -> None:
    assert lanes(context(magic_tuple=lambda: ("x86_64", "haswell", "+avx2,-avx512f"))) == 8
    assert lanes(context(magic_tuple=lambda: ("x86_64", "skylake-avx512", "+avx2,+avx512f"))) == 16


def test_the_variable_of_numba_counts_without_its_key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "CPU_FEATURES", "+avx2")
    assert (_features(context()), lanes(context())) == ("+avx2", 8)
