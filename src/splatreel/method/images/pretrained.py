"""Pretrained networks whose packages and weights may be missing. Nothing is downloaded."""

from __future__ import annotations

import importlib
import os
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from splatreel.base.command_line import install_command
from splatreel.base.errors import MissingDependencyError


@dataclass(frozen=True)
class Pretrained:
    """A network of the extra `splatreel[models]`.

    Attributes:
        purpose: First words of error messages: the feature that needs the network.
        variable: Environment variable with the path of the weights.
        remedy: Alternative to suggest to the user.
    """

    purpose: str
    package: str
    module: str
    file: str
    url: str
    variable: str
    remedy: str
    install: str = ""

    def check(self) -> None:
        """Raise a `MissingDependencyError` if the package or the weights are missing. The weights are not loaded."""
        self.import_module()
        self.find_weights(None)

    def import_module(self) -> ModuleType:
        """Return the module that builds the network, or raise a `MissingDependencyError`."""
        try:
            return importlib.import_module(self.module)
        except (ImportError, RuntimeError) as error:  # RuntimeError: built for another version of torch
            raise MissingDependencyError(
                f"{self.purpose} needs {self.package}, which cannot be imported ({error}). "
                f"Run: {install_command('models')}{self.install}; or {self.remedy}."
            ) from error

    def find_weights(self, given: Path | None) -> Path:
        """Return the weights: the given path, the environment variable's, or torch's cache; or raise as `check` does."""
        path = Path(given or os.environ.get(self.variable) or cached_weights(self.file))
        if not path.is_file():
            raise MissingDependencyError(
                f"{self.purpose} needs its weights, but {path} does not exist. Download {self.url} to that path, or set "
                f"{self.variable} to the path of the file; or {self.remedy}."
            )
        return path


def cached_weights(file: str) -> Path:
    """Return the path at which PyTorch's hub stores a downloaded file of weights. It follows the hub's environment variables."""
    caches = os.environ.get("XDG_CACHE_HOME", "~/.cache")
    home = os.environ.get("TORCH_HOME", os.path.join(caches, "torch"))
    return Path(home).expanduser() / "hub" / "checkpoints" / file
