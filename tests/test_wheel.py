"""The package as others get it: a wheel, installed into an environment of its own without torch, and used."""

import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
USE = """
import sys
import splatreel
reel = splatreel.open_reel(sys.argv[1])
gaussians = reel.at(0.5 * reel.duration)
image = reel.render(gaussians, reel.manifest.camera)
assert image.shape == (reel.manifest.camera.height, reel.manifest.camera.width, 3), image.shape
assert image.max() > 0.05, "the picture is black"
assert "torch" not in sys.modules
assert "site-packages" in splatreel.__file__, splatreel.__file__
print(len(gaussians), "Gaussians")
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    (made,) = folder.glob("*.whl")
    return made


def test_the_wheel_holds_the_player_and_the_licence_and_no_tests(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    static = [p for p in (ROOT / "src" / "splatreel" / "play" / "static").rglob("*") if p.is_file()]
    assert static
    for path in static:
        assert path.relative_to(ROOT / "src").as_posix() in names
    assert any(name.endswith("/licenses/LICENSE") for name in names)
    assert not [name for name in names if name.startswith(("tests", "benchmarks")) or "node_modules" in name]


@pytest.mark.slow
def test_a_clean_environment_plays_a_reel_without_torch(wheel: Path, tmp_path: Path) -> None:
    venv.create(tmp_path / "env", with_pip=True)
    binaries = tmp_path / "env" / ("Scripts" if os.name == "nt" else "bin")
    python = str(binaries / "python")
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}

    def run(*command: str) -> str:
        result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
        assert result.returncode == 0, result.stderr
        return result.stdout

    install = [python, "-m", "pip", "install", "--quiet", "--constraint", str(ROOT / "constraints.txt"), str(wheel)]
    installed = subprocess.run(install, env=environment, capture_output=True, text=True, timeout=300)
    if installed.returncode != 0 and "No matching distribution" in installed.stderr:
        pytest.skip("pip reaches no package index from here")
    assert installed.returncode == 0, installed.stderr
    assert "torch" not in run(python, "-m", "pip", "list")
    splatreel, golden = str(binaries / "splatreel"), str(ROOT / "tests" / "data" / "golden")
    assert "reconstruct" in run(splatreel, "--help")
    assert "dynamic points" in run(splatreel, "info", golden)
    assert "whole" in run(splatreel, "verify", golden)
    assert "Gaussians" in run(python, "-c", USE, golden)
    run(splatreel, "export", golden, "--frame", "0", "--out", str(tmp_path / "frame.ply"))
    failed = subprocess.run(
        [splatreel, "reconstruct", str(tmp_path), "--out", str(tmp_path / "out")],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert failed.returncode == 1
    assert "pip install 'splatreel[recon]'" in failed.stderr
    assert "Traceback" not in failed.stderr
