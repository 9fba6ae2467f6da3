"""Settings that must be in place before torch loads its OpenMP runtime; how tests are shared among processes."""

import itertools
import os
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.buckets import Bucket, Faults

# Torch's threads sleep while they wait, as in the command line: spinning, they would keep the kernels' threads from the cores.
os.environ.setdefault("GOMP_SPINCOUNT", "0")

# Each of several test processes has its share of the cores.
if WORKERS := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "0")):
    os.environ.setdefault("OMP_NUM_THREADS", str(max((os.cpu_count() or 1) // WORKERS, 1)))

# A shell starts what runs in its background deaf to Ctrl-C, and the commands under test would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

TOGETHER = (
    "tests/run/machines/test_batch.py",
    "tests/run/machines/test_driver_ends.py",
    "tests/run/machines/test_local_processes.py",
)
TOGETHER += ("tests/run/machines/test_ray_cluster.py",)
"""Files whose tests share what is expensive to make once a process: the run and the reel of `recon/machines/conftest.py`."""
FIRST = ("tests/cli/test_kills.py", TOGETHER[0], "tests/player/test_source.py", "tests/run/test_jobs.py")
FIRST += ("tests/run/live/test_following.py", "tests/benchmarks/test_gpu.py", "tests/player/test_follow.py")
FIRST += ("tests/method/cameras/test_poses.py", "tests/cli/test_demo.py", "tests/calibration/test_calibrate.py")
FIRST += ("tests/benchmarks/test_curve.py", "tests/cli/test_interruption.py", "tests/kernels/test_rasterize.py")
"""Files that take longest: begun last, one process would be busy with them while the others are done."""


def group_of(nodeid: str) -> str:
    """Return the name that is common to all tests that one process runs: their file's, mostly."""
    path = nodeid.partition("::")[0]
    return TOGETHER[0] if path in TOGETHER else path


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    from xdist.scheduler import LoadScopeScheduling

    class GroupScheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return group_of(nodeid)

    config.option.loadscopereorder = False  # in the order of the collection, not by the number of tests
    return GroupScheduling(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put first what takes longest, where the tests are shared among processes."""
    if WORKERS:
        rank = {path: number for number, path in enumerate(FIRST)}
        items.sort(key=lambda item: rank.get(group_of(item.nodeid), len(FIRST)))


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


@pytest.fixture(scope="session")
def faulty_server() -> Iterator[tuple[str, "Faults"]]:
    """The address of an S3-compatible server and its faults, started once."""
    from tests import buckets

    with buckets.faulty_server() as server:
        yield server


@pytest.fixture
def faulty(faulty_server: tuple[str, "Faults"], monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple["Bucket", "Faults"]]:
    """A new bucket of a server with faults, which neither botocore nor s3fs retries. Retries follow at once."""
    from splatreel.storage import address as module
    from tests.buckets import CREDENTIALS, Bucket

    boto3 = pytest.importorskip("boto3")
    s3fs = pytest.importorskip("s3fs")
    address, faults = faulty_server
    settings = {"AWS_ENDPOINT_URL": address, "AWS_MAX_ATTEMPTS": "1", "AWS_RETRY_MODE": "standard"}
    for name, value in {**CREDENTIALS, **settings}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(s3fs.S3FileSystem, "retries", 1)
    monkeypatch.setattr(module, "PAUSES", (0.0, 0.0, 0.0))
    s3fs.S3FileSystem.clear_instance_cache()  # its keys do not include the server
    client = boto3.client("s3")
    name = f"faulty-{next(_NUMBERS)}"
    client.create_bucket(Bucket=name)
    yield Bucket(name, address, client), faults
    faults.begin("", (), 0)
    s3fs.S3FileSystem.clear_instance_cache()
