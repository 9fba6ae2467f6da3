import pytest

from tests.storage.folders import KINDS, new_address


@pytest.fixture(params=KINDS)
def address(request: pytest.FixtureRequest) -> str:
    """Of a new folder, once for each kind of storage."""
    return new_address(request.param, request)
