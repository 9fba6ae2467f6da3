import shutil
from pathlib import Path

import pytest

from splatreel.progress import Silent
from splatreel.recon.encode.group_writer import no_presentation
from splatreel.recon.jobs import publish_job
from splatreel.recon.machines.reports import Report
from splatreel.recon.machines.worker_pool import WorkerPool
from tests.recon.machines.runs import make_scene, spec
from tests.recon.test_pipeline import content


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of which the scene is there."""
    return make_scene(tmp_path_factory.mktemp("machines") / "out")


@pytest.fixture
def out(scene: Path, tmp_path: Path) -> Path:
    """The same, to be gone on with."""
    return shutil.copytree(scene, tmp_path / "out")


@pytest.fixture(scope="session")
def expected(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The files of the reel, made by one process of one thread that nothing disturbs."""
    out = shutil.copytree(scene, tmp_path_factory.mktemp("expected") / "out")
    reports: list[Report] = []
    with spec(out).opened() as run, WorkerPool(spec(out), [None], 1, 0) as pool:
        pool.make(range(3), reports.append)
        publish_job(run, Silent(), no_presentation)
    return content(out / "reel")
