"""Record what the readable torch versions return, for tests that run without torch: `python -m tests.kernels.record`."""

from pathlib import Path

import numpy as np

from tests.kernels.cases import CASES, Case, doubles
from tests.kernels.compare import Arrays, slopes

FOLDER = Path(__file__).parents[1] / "data" / "kernels"


def by_twin(case: Case) -> tuple[Arrays, Arrays]:
    """Return the outputs, and the gradients to the inputs for the `slopes` of the outputs."""
    import torch

    leaves = [doubles(array).requires_grad_() for array in case.inputs]
    outputs = tuple(case.twin(*leaves))
    arrays = tuple(output.detach().numpy() for output in outputs)
    floats = [output for output in outputs if output.is_floating_point() and output.requires_grad]
    if floats:
        torch.autograd.backward(floats, [torch.from_numpy(slope).double() for slope in slopes(arrays)])
    gradients = tuple((torch.zeros_like(leaf) if leaf.grad is None else leaf.grad).numpy() for leaf in leaves)
    return arrays, gradients


def recorded(case: Case) -> tuple[list[np.ndarray], Arrays, Arrays]:
    """Return inputs, outputs and gradients from the file."""
    with np.load(FOLDER / f"{group(case)}.npz") as file:
        found = [
            [file[f"{case.name}/{kind}{k}"] for k in range(99) if f"{case.name}/{kind}{k}" in file] for kind in KINDS
        ]
    inputs, outputs, gradients = found
    return inputs, tuple(outputs), tuple(gradients)


KINDS = "input", "output", "gradient"


def group(case: Case) -> str:
    return case.name.replace(",", "").split()[0]


def record() -> None:
    FOLDER.mkdir(exist_ok=True)
    files: dict[str, dict[str, np.ndarray]] = {}
    for case in CASES:
        if case.recorded:
            values = files.setdefault(group(case), {})
            for kind, arrays in zip(KINDS, (case.inputs, *by_twin(case)), strict=True):
                for k, array in enumerate(arrays):
                    single = array.astype(np.float32) if array.dtype.kind == "f" else array
                    values[f"{case.name}/{kind}{k}"] = single
    for name, arrays in files.items():
        np.savez_compressed(FOLDER / f"{name}.npz", allow_pickle=False, **arrays)
    print(f"{sum(path.stat().st_size for path in FOLDER.iterdir()) / 1e3:.0f} kB in {FOLDER}")


if __name__ == "__main__":
    record()
