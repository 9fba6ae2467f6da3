"""What lies in `deploy/`: scripts that keep their arguments, and descriptions of jobs that fit the command."""

import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

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
