"""Pretrained networks whose packages and weights may be missing. Nothing is downloaded."""

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

    Attributes:
        purpose: First words of error messages: the feature that needs the network.
        package: Package, as named in messages.
        file: File of its weights.
        url: Address of the weights.
        variable: Environment variable with the path of the weights.
        remedy: Alternative to suggest to the user.
        install: Further advice on installation.
    """

    purpose: str
    package: str
    file: str
    url: str
    variable: str
    remedy: str
    install: str = ""

    def import_package(self, load: Callable[[], T]) -> T:
        """Call a function that imports the package, and return its result.

        Raises:
            MissingDependencyError: If the import fails.
        """
        try:
            return load()
        except (ImportError, RuntimeError) as error:  # RuntimeError: built for another version of torch
            raise MissingDependencyError(
                f"{self.purpose} needs {self.package}, which cannot be imported ({error}). "
                f"Run: pip install 'splatreel[models]'{self.install}; or {self.remedy}."
            ) from error

    def find_weights(self, given: Path | None) -> Path:
        """Return the file of the weights: the given path, the environment variable's, or the one in torch's download cache.

        Raises:
            MissingDependencyError: If there is no such file.
        """
        path = Path(given or os.environ.get(self.variable) or cached_weights(self.file))
        if not path.is_file():
            raise MissingDependencyError(
                f"{self.purpose} needs its weights, but {path} does not exist. Download {self.url} to that path, or set "
                f"{self.variable} to the path of the file; or {self.remedy}."
            )
        return path


def cached_weights(file: str) -> Path:
    """Return the path at which torch stores a downloaded file of weights."""
    import torch

    return Path(torch.hub.get_dir()) / "checkpoints" / file
