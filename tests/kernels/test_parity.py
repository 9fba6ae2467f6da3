"""Kernels compared with recorded results of their readable torch versions, with these versions, and with finite differences."""

from collections.abc import Sequence

import numpy as np
import pytest

from tests.kernels.cases import CASES, Case
from tests.kernels.compare import Arrays, assert_close, assert_equals_differences, slopes
from tests.kernels.record import by_twin, recorded


def assert_kernel_gives(case: Case, inputs: Sequence[np.ndarray], outputs: Arrays, gradients: Arrays) -> None:
    found, gradient = case.kernel(*inputs)
    assert len(found) == len(outputs)
    for k, (a, b) in enumerate(zip(found, outputs, strict=True)):
        if a.dtype.kind == "f":
            assert_close(a, b, case.tolerance, f"output {k}")
        else:
            np.testing.assert_array_equal(a, b)
    for k, (a, b) in enumerate(zip(gradient(slopes(found)), gradients, strict=True)):
        if a is not None:
            assert_close(a, b, case.tolerance, f"gradient to input {k}")


@pytest.mark.parametrize("case", [case for case in CASES if case.recorded], ids=repr)
def test_kernel_gives_recorded_results(case: Case) -> None:
    assert_kernel_gives(case, *recorded(case))


@pytest.mark.parametrize("case", [case for case in CASES if case.step is not None], ids=repr)
def test_gradients_equal_finite_differences(case: Case) -> None:
    assert case.step is not None
    assert_equals_differences(case.kernel, case.inputs, case.step, 0.02)


@pytest.mark.oracle
@pytest.mark.parametrize("case", CASES, ids=repr)
def test_kernel_equals_torch(case: Case) -> None:
    pytest.importorskip("torch")
    assert_kernel_gives(case, case.inputs, *by_twin(case))


@pytest.mark.oracle
@pytest.mark.parametrize("case", [case for case in CASES if case.recorded], ids=repr)
def test_recorded_results_are_those_of_torch(case: Case) -> None:
    """If not, run `python -m tests.kernels.record`."""
    pytest.importorskip("torch")
    _, *before = recorded(case)
    for kind, (old, new) in enumerate(zip(before, by_twin(case), strict=True)):
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            assert_close(a, b, 1e-5, f"{('output', 'gradient')[kind]} {k}")
