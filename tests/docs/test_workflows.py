"""The files of GitHub's services: they are valid, and they call what exists."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from coverage import CoverageData

ROOT = Path(__file__).parent.parent.parent
GITHUB = ROOT / ".github"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKFLOWS = sorted((GITHUB / "workflows").glob("*.yml"))
FILES = [*sorted(GITHUB.rglob("*.yml")), ROOT / ".pre-commit-config.yaml", ROOT / "CITATION.cff"]


def load(path: Path) -> Any:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def jobs() -> list[tuple[str, dict[str, Any]]]:
    return [(f"{path.stem}/{name}", job) for path in WORKFLOWS for name, job in load(path)["jobs"].items()]


def steps() -> list[dict[str, Any]]:
    return [step for _, job in jobs() for step in job["steps"]]


def python_versions() -> set[str]:
    """Return the Python versions in the workflows' matrices."""
    return {version for _, job in jobs() for version in job.get("strategy", {}).get("matrix", {}).get("python", [])}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_yaml_files_load(path: Path) -> None:
    assert isinstance(load(path), dict)


def test_workflows_call_make_targets_that_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z-]+):(?!=)", makefile, re.MULTILINE))
    called = {name for step in steps() for name in re.findall(r"\bmake ([a-z-]+)", step.get("run", ""))}
    assert {"check", "test", "test-all", "wheel", "npm-package", "docs"} <= called
    assert called <= targets


def test_every_target_is_declared_phony() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (phony,) = re.findall(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)
    assert set(phony.split()) == set(re.findall(r"^([a-z-]+):(?!=)", makefile, re.MULTILINE))


def test_workflows_test_the_python_versions_of_the_package() -> None:
    prefix = "Programming Language :: Python :: "
    classified = {name.removeprefix(prefix) for name in PROJECT["classifiers"] if name.startswith(prefix + "3.")}
    assert python_versions() == classified
    oldest = min(classified, key=lambda version: int(version.split(".")[1]))
    assert PROJECT["requires-python"] == f">={oldest}"


def test_workflows_test_three_systems() -> None:
    (systems,) = {tuple(job["strategy"]["matrix"]["os"]) for _, job in jobs() if "strategy" in job}
    assert {name.split("-")[0] for name in systems} == {"ubuntu", "macos", "windows"}


def test_workflows_may_only_read_unless_a_job_asks_for_more() -> None:
    assert [path.name for path in WORKFLOWS if load(path)["permissions"] != {"contents": "read"}] == []


def test_dependabot_watches_folders_that_exist() -> None:
    updates = load(GITHUB / "dependabot.yml")["updates"]
    npm = next(update for update in updates if update["package-ecosystem"] == "npm")
    folders = [ROOT / folder.lstrip("/") for folder in npm["directories"]]
    assert [folder for folder in folders if not (folder / "package.json").is_file()] == []


def test_pre_commit_runs_the_pinned_version_of_ruff() -> None:
    repositories = {entry["repo"].rsplit("/", 1)[1]: entry["rev"] for entry in load(FILES[-2])["repos"]}
    assert f"ruff=={repositories['ruff-pre-commit'].removeprefix('v')}\n" in (ROOT / "constraints.txt").read_text()


def test_the_citation_is_of_this_version() -> None:
    citation = load(ROOT / "CITATION.cff")
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert citation["repository-code"] == PROJECT["urls"]["Repository"]


def test_actions_are_pinned_by_hash() -> None:
    """A tag can move. The comment behind the hash names the version, from which Dependabot goes on."""
    pinned = re.compile(r"[\w.-]+/[\w./-]+@[0-9a-f]{40}  # v\d+\.\d+\.\d+")
    named = [line for path in WORKFLOWS for line in path.read_text(encoding="utf-8").splitlines() if "uses: " in line]
    assert named
    assert [line.strip() for line in named if not pinned.fullmatch(line.partition("uses: ")[2])] == []
    versions = {tuple(re.split("@|  # ", line.partition("uses: ")[2])) for line in named}
    assert len(versions) == len({name for name, *_ in versions}), "one version of each action"


def test_workflows_retry_what_the_local_run_retries() -> None:
    retries = "RETRY=1" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert (load(GITHUB / "workflows" / "ci.yml")["env"].get("RETRY") == 1) == retries


def test_coverage_below_the_threshold_fails(tmp_path: Path) -> None:
    """The last command of `make test-all` reads the threshold of pyproject.toml. Here one line of a file ran."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert "\t$(BIN)/coverage json --quiet -o out/coverage.json\n" in makefile, "make ends with its exit status"
    data = CoverageData(str(tmp_path / "data"))
    data.add_lines({str(ROOT / "src" / "splatreel" / "base/errors.py"): [1]})
    data.write()
    report = [sys.executable, "-m", "coverage", "json", f"--data-file={tmp_path / 'data'}", f"-o{tmp_path / 'json'}"]
    ended = subprocess.run(report, cwd=ROOT, capture_output=True, text=True)
    assert ended.returncode == 2, ended.stderr
    assert "is less than fail-under" in ended.stdout
