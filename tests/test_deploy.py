"""Files in `deploy/`: scripts pass their arguments on, and job descriptions match the command."""

import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from splatreel.cli.main import main

DEPLOY = Path(__file__).parent.parent / "deploy"
SBATCH = """#!/bin/bash
printf '%s\\0' "$@" >> "$SUBMITTED"
printf '\\n' >> "$SUBMITTED"
echo $RANDOM
"""


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_the_script_for_slurm_passes_its_arguments_on(tmp_path: Path) -> None:
    sbatch = tmp_path / "bin" / "sbatch"
    sbatch.parent.mkdir()
    sbatch.write_text(SBATCH)
    sbatch.chmod(0o755)
    submitted = tmp_path / "submitted"
    environment = os.environ | {
        "PATH": f"{sbatch.parent}:{os.environ['PATH']}",
        "SUBMITTED": str(submitted),
        "CHAPTERS": "7",
    }
    given = ["my films/a 'take' $HOME", "--out", "/data/out one", "--set", "group.lambda_arap=0"]
    subprocess.run(["bash", DEPLOY / "slurm" / "reel.sh", *given], env=environment, check=True, timeout=60)
    jobs = [line.split("\0")[:-1] for line in submitted.read_text().splitlines()]
    wrapped = [shlex.split(job[job.index("--wrap") + 1]) for job in jobs]
    assert wrapped == [["splatreel", "reconstruct", *given, "--job", job] for job in ("scene", "chapter", "finish")]
    assert "--array=0-6" in jobs[1]
    assert ["--kill-on-invalid-dep=yes" in job for job in jobs] == [False, True, True]


def commands() -> list[list[str]]:
    """The arguments of `splatreel` in all descriptions of jobs."""
    yaml = pytest.importorskip("yaml")
    found = []
    for file in sorted((DEPLOY / "kubernetes").glob("*.yaml")):
        for document in yaml.safe_load_all(file.read_text(encoding="utf-8")):
            if document["kind"] == "RayJob":
                found.append(shlex.split(document["spec"]["entrypoint"])[1:])
            else:
                found += [pod["args"] for pod in document["spec"]["template"]["spec"]["containers"]]
    return found


def test_jobs_of_kubernetes_give_arguments_that_the_command_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A wrong argument exits with 2. Here only the capture is missing, which exits with 1."""
    assert len(commands()) == 4
    for command in commands():
        places = {
            "/data/capture": "missing",
            "s3://BUCKET/capture": "missing",
            "/data/out": "out",
            "s3://BUCKET/run": "out",
        }
        given = [str(tmp_path / places[word]) if word in places else word for word in command]
        given = [word.replace("$(JOB_COMPLETION_INDEX)", "3") for word in given]
        code, why = (2, "no Ray cluster answers") if "--cluster" in given else (1, "missing: is not a folder")
        assert main(given) == code, command
        assert why in capsys.readouterr().err


def test_an_indexed_job_has_as_many_tasks_as_its_command_says() -> None:
    yaml = pytest.importorskip("yaml")
    documents = yaml.safe_load_all((DEPLOY / "kubernetes" / "chapters.yaml").read_text(encoding="utf-8"))
    (indexed,) = [d for d in documents if d["spec"].get("completionMode") == "Indexed"]
    (args,) = [pod["args"] for pod in indexed["spec"]["template"]["spec"]["containers"]]
    assert args[args.index("--chapter") + 1] == f"$(JOB_COMPLETION_INDEX)/{indexed['spec']['completions']}"
