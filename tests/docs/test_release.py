"""The workflow `release.yml`: its commands run, without uploading anything, on packages as `make npm-package` names them."""

import json
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parent.parent.parent
PLAYER = ROOT / "player"
PACKAGES = [PLAYER, *(PLAYER / "packages" / name for name in ("decoder", "playcanvas", "three"))]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
JOBS: dict[str, Any] = yaml.safe_load((ROOT / ".github/workflows/release.yml").read_text(encoding="utf-8"))["jobs"]
NOWHERE = {"npm_config_registry": "http://127.0.0.1:9/", "npm_config_fetch_retries": "0"}
needs_npm = pytest.mark.skipif(shutil.which("npm") is None or os.name != "posix", reason="needs npm and a shell")


def commands(job: str) -> list[str]:
    return [step["run"] for step in JOBS[job]["steps"] if ".ci/publish-npm" in step.get("run", "")]


def manifest(package: Path) -> dict[str, Any]:
    return json.loads((package / "package.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the packages in dist, packed without building their contents, and with the scripts of the workflow."""
    root = tmp_path_factory.mktemp("checkout")
    for package in PACKAGES:
        copy = root / package.relative_to(ROOT)
        (copy / "dist").mkdir(parents=True)
        (copy / "dist" / "index.js").write_text("export {};\n", encoding="utf-8")
        shutil.copy(package / "package.json", copy)
    (root / "dist").mkdir()
    shutil.copytree(ROOT / ".ci", root / ".ci")
    pack = ["npm", "pack", "--ignore-scripts", "--workspaces", "--include-workspace-root", "--pack-destination=../dist"]
    subprocess.run(pack, cwd=root / "player", check=True, capture_output=True, env=os.environ | NOWHERE)
    return root


def run(command: str, checkout: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", "-e", "-c", command],
        cwd=checkout,
        env=os.environ | NOWHERE | environment,
        capture_output=True,
        text=True,
        timeout=600,
    )


@needs_npm
@pytest.mark.slow
@pytest.mark.parametrize("job", ["build", "npm"])
def test_all_packages_are_accepted_by_npm_publish(checkout: Path, job: str) -> None:
    """`npm_config_dry_run` has the effect of `--dry-run`, which only the job `build` gives."""
    (command,) = commands(job)
    ended = run(command, checkout, npm_config_dry_run="true")
    assert ended.returncode == 0, ended.stderr
    published = set(re.findall(r"^\+ (\S+)$", ended.stdout, re.MULTILINE))
    assert published == {f"{entry['name']}@{entry['version']}" for entry in map(manifest, PACKAGES)}


@needs_npm
def test_versions_that_are_published_are_left_out(checkout: Path, tmp_path: Path) -> None:
    """A stand-in for npm knows two of the four packages."""
    stand_in = tmp_path / "npm"
    known = '"view splatreel-player@"*|"view @splatreel/three@"*'
    script = f'#!/bin/sh\ncase "$1 $2" in {known}) echo 0.1.0;; view*) exit 1;; *) echo "$@";; esac\n'
    stand_in.write_text(script, encoding="utf-8")
    stand_in.chmod(0o755)
    (command,) = commands("npm")
    ended = run(command, checkout, PATH=f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    assert ended.returncode == 0, ended.stderr
    uploads = [line for line in ended.stdout.splitlines() if line.startswith("publish ")]
    assert [re.sub(r"-[\d.]+\.tgz", "", line) for line in uploads] == [
        "publish --access public ./dist/splatreel-decoder",
        "publish --access public ./dist/splatreel-playcanvas",
    ]


@needs_npm
@pytest.mark.slow
def test_a_package_that_npm_rejects_fails_the_job(checkout: Path, tmp_path: Path) -> None:
    broken = shutil.copytree(checkout, tmp_path / "broken")
    (broken / "dist" / "splatreel-three-9.9.9.tgz").write_bytes(b"no archive")
    assert run(commands("build")[0], broken).returncode != 0
    shutil.rmtree(broken / "dist")
    (broken / "dist").mkdir()
    ended = run(commands("build")[0], broken)
    assert ended.returncode != 0
    assert "make npm-package" in ended.stderr


def test_pypi_waits_for_the_dry_run_of_npm() -> None:
    assert [command.split()[-1] for command in commands("build")] == ["--dry-run"]
    assert (JOBS["python"]["needs"], JOBS["npm"]["needs"]) == ("build", "python")
    assert JOBS["python"]["steps"][-1]["with"]["skip-existing"] is True


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_packages_name_their_repository(package: Path) -> None:
    """npm's trusted publishing compares the repository with the one whose workflow uploads."""
    assert manifest(package)["repository"] == {
        "type": "git",
        "url": f"git+{PROJECT['urls']['Repository']}.git",
        "directory": package.relative_to(ROOT).as_posix(),
    }
    assert manifest(package)["version"] == PROJECT["version"]
