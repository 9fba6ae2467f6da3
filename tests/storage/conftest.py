import pytest

from tests.storage.folders import KINDS, new_address


@pytest.fixture(params=KINDS)
def address(request: pytest.FixtureRequest) -> str:
    """Return the address of a new folder for each kind of storage."""
    return new_address(request.param, request)
