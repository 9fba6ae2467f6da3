"""Settings that must be in place before numba and torch load their OpenMP runtimes; what is said when all tests are done."""

import itertools
import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests import coverage

if TYPE_CHECKING:
    from tests.buckets import Bucket

# With another process on a core, spinning at barriers makes every parallel region wait for a whole scheduler tick.
os.environ.setdefault("GOMP_SPINCOUNT", "0")

# A shell starts what runs in its background deaf to Ctrl-C, and the commands under test would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

COVERAGE = coverage.start() if "--coverage" in sys.argv else None  # before the conftest of a folder imports the package
LAST_LINES = pytest.StashKey[list[str]]()
MISSED = Path(__file__).parent.parent / "out" / "coverage.json"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--coverage",
        action="store_true",
        help="say how much of the package the tests ran; out/coverage.json lists what did not",
    )


def pytest_configure(config: pytest.Config) -> None:
    config.stash[LAST_LINES] = []


@pytest.fixture(scope="session")
def last_lines(pytestconfig: pytest.Config) -> list[str]:
    """Lines to be printed below the results of all tests: append to them."""
    return pytestconfig.stash[LAST_LINES]


@pytest.fixture(scope="session")
def s3_server() -> Iterator[str]:
    """The address of an S3-compatible server, started once."""
    from tests import buckets

    with buckets.s3_server() as address:
        yield address


_NUMBERS = itertools.count()


@pytest.fixture
def bucket(s3_server: str, monkeypatch: pytest.MonkeyPatch) -> "Bucket":
    """A new bucket, to which `s3://` leads while the test runs, also for the programs that it starts."""
    from tests.buckets import CREDENTIALS, Bucket

    boto3 = pytest.importorskip("boto3", reason="the tests with buckets need moto and s3fs")
    pytest.importorskip("s3fs", reason="the tests with buckets need moto and s3fs")
    for name, value in {**CREDENTIALS, "AWS_ENDPOINT_URL": s3_server}.items():
        monkeypatch.setenv(name, value)
    client = boto3.client("s3")
    name = f"bucket-{next(_NUMBERS)}"
    client.create_bucket(Bucket=name)
    return Bucket(name, s3_server, client)


def pytest_unconfigure(config: pytest.Config) -> None:
    if COVERAGE is not None:
        MISSED.parent.mkdir(exist_ok=True)
        MISSED.write_text(json.dumps(COVERAGE.missed(), indent=1))
        print(COVERAGE.summary())
    for line in config.stash[LAST_LINES]:
        print(line)
