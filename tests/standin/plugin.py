"""Plugin for `pytest -p tests.standin.plugin`: tests that need a GPU run on the simulated GPU."""

from contextlib import ExitStack

import pytest

from tests.standin.gpu import gpu


def pytest_configure(config: pytest.Config) -> None:
    machine = ExitStack()
    machine.enter_context(gpu())
    config.add_cleanup(machine.close)
