"""The package as others get it: a wheel, installed into an environment of its own without torch, and used."""

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parent.parent
USE = """
import importlib.util, sys
import splatreel
import splatreel.play.film, splatreel.play.presentation_writer, splatreel.play.server
assert importlib.util.find_spec("torch") is None, "torch is installed"
reel = splatreel.open_reel(sys.argv[1])
gaussians = reel.at(0.5 * reel.duration)
image = reel.render(gaussians, reel.manifest.camera)
assert image.shape == (reel.manifest.camera.height, reel.manifest.camera.width, 3), image.shape
assert image.max() > 0.05, "the image is black"
assert "site-packages" in splatreel.__file__, splatreel.__file__
print(len(gaussians), "Gaussians")
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True, timeout=6000)
    (made,) = folder.glob("*.whl")
    return made


@pytest.mark.wheel
def test_the_wheel_holds_the_player_the_film_the_sample_and_the_licence_and_no_tests(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    package = ROOT / "src" / "splatreel"
    folders = package / "play" / "static", package / "capture" / "film"
    assert all(folder.is_dir() for folder in folders)
    for path in (p for folder in (*folders, package / "play" / "sample") for p in folder.rglob("*") if p.is_file()):
        assert path.relative_to(ROOT / "src").as_posix() in names
    assert any(name.endswith("/licenses/LICENSE") for name in names)
    assert not [name for name in names if name.startswith(("tests", "benchmarks")) or "node_modules" in name]


def requirements(wheel: Path) -> set[str]:
    """Names of what the wheel says that it needs, without extras, and of what that needs in turn."""
    (folder,) = (path for path in zipfile.Path(wheel).iterdir() if path.name.endswith(".dist-info"))
    found: set[str] = set()
    open_ends = list(metadata.PathDistribution(folder).requires or [])
    while open_ends:
        needed = Requirement(open_ends.pop())
        name = canonicalize_name(needed.name)
        if name not in found and (needed.marker is None or needed.marker.evaluate({"extra": ""})):
            found.add(name)
            open_ends += metadata.requires(name) or []
    return found


def install(wheel: Path, folder: Path) -> Path:
    """The folder of commands of a new environment: what the wheel needs is linked to what is here, nothing else is there."""
    venv.create(folder, with_pip=False)
    binaries = folder / ("Scripts" if os.name == "nt" else "bin")
    paths = {"base": str(folder), "platbase": str(folder)}
    packages = Path(sysconfig.get_path("purelib", "venv", vars=paths))
    for name in requirements(wheel):
        distribution = metadata.distribution(name)
        for part in {file.parts[0] for file in distribution.files or []} - {"..", "__pycache__"}:
            (packages / part).symlink_to(str(distribution.locate_file(part)))
    pip = [sys.executable, "-m", "pip", "--python", str(binaries / "python")]
    subprocess.run([*pip, "install", "--quiet", "--no-deps", "--no-index", str(wheel)], check=True, timeout=6000)
    subprocess.run([*pip, "check"], check=True, timeout=6000)
    return binaries


@pytest.mark.wheel
def test_a_clean_environment_plays_a_reel_without_torch(wheel: Path, tmp_path: Path) -> None:
    binaries = install(wheel, tmp_path / "env")
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}

    def run(*command: str) -> str:
        result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=6000)
        assert result.returncode == 0, result.stderr
        return result.stdout

    python, splatreel, golden = (
        str(binaries / "python"),
        str(binaries / "splatreel"),
        str(ROOT / "tests" / "data" / "golden"),
    )
    assert "reconstruct" in run(splatreel, "--help")
    assert "dynamic points" in run(splatreel, "info", golden)
    assert "complete" in run(splatreel, "verify", golden)
    assert "Gaussians" in run(python, "-c", USE, golden)
    run(splatreel, "export", golden, "--frame", "0", "--out", str(tmp_path / "frame.ply"))
    failed = subprocess.run(
        [splatreel, "reconstruct", str(tmp_path), "--out", str(tmp_path / "out")],
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert failed.returncode == 1
    assert 'pip install "splatreel[recon]"' in failed.stderr
    assert "Traceback" not in failed.stderr
