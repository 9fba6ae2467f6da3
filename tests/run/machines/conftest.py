import shutil
from pathlib import Path

import pytest

from splatreel.base.progress import Silent
from splatreel.run.jobs import reel_job
from splatreel.run.machines.local_processes import WorkerPool
from splatreel.run.machines.reports import Report
from splatreel.run.output.group_writer import no_presentation
from tests.run.machines.runs import make_scene, spec
from tests.run.test_pipeline import content


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose shared scene is finished."""
    return make_scene(tmp_path_factory.mktemp("machines") / "out")


@pytest.fixture
def out(scene: Path, tmp_path: Path) -> Path:
    """A copy of this run, to be continued."""
    return shutil.copytree(scene, tmp_path / "out")


@pytest.fixture(scope="session")
def expected(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Files of the reel as one undisturbed process makes it."""
    out = shutil.copytree(scene, tmp_path_factory.mktemp("expected") / "out")
    reports: list[Report] = []
    with spec(out).opened() as run, WorkerPool(spec(out), [None], 1, 0) as pool:
        pool.make(range(3), reports.append)
        reel_job(run, Silent(), no_presentation)
    return content(out / "reel")
