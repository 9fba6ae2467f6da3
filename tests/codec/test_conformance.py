"""The Python reader and @splatreel/decoder pass the conformance suite, and its checks find mistakes."""

import gzip
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conformance.run import HERE, arrays_of, cases, differences, expected, refusal_of, refused, write_refused

from tests.conformance_cases import CASES, write_case

ROOT = HERE.parent
DECODER = ROOT / "player" / "packages" / "decoder"


@pytest.mark.parametrize("case", CASES)
def test_the_python_reader_passes(case: str) -> None:
    wanted = expected(case)
    assert differences(case, arrays_of(HERE / case, wanted["times"], wanted["renditions"])) == []


@pytest.mark.parametrize("name", refused())
def test_the_python_reader_refuses_false_reels(name: str, tmp_path: Path) -> None:
    write_refused(name, tmp_path / name)
    assert refusal_of(tmp_path / name)


@pytest.mark.slow
def test_the_decoder_passes() -> None:
    if shutil.which("npm") is None:
        pytest.skip("needs node and npm")
    assert (ROOT / "player" / "node_modules").is_dir(), "npm ci in player/"
    for command in (["node", DECODER / "build.mjs"], ["node", HERE / "run.mjs"]):
        result = subprocess.run(command, cwd=ROOT / "player", capture_output=True, text=True, timeout=600)
        assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout.count("are right") == len(CASES)
    assert result.stdout.count(" is refused: ") == len(refused())
    scripts = [DECODER / "dist" / name for name in ("decoder.js", "decode-worker.js")]
    assert sum(len(gzip.compress(script.read_bytes())) for script in scripts) < 40_000


def test_wrong_arrays_are_found() -> None:
    wanted = expected("shade")
    arrays = arrays_of(HERE / "shade", wanted["times"], wanted["renditions"])
    lacking = {name: array for name, array in arrays.items() if name != "group1.shade"}
    assert differences("shade", lacking) == ["shade: group1.shade is missing"]
    assert differences("shade", arrays | {"layer0.means": arrays["layer0.means"][:-1]}) != []
    assert differences("shade", arrays | {"group1.alive": ~arrays["group1.alive"]}) != []
    assert differences("shade", arrays | {"layer0.sh": arrays["layer0.sh"][::-1]}) != []
    off = arrays | {"group0.dq": arrays["group0.dq"] + np.float32(1e-3)}
    assert differences("shade", off) != []
    assert differences("shade", off, for_display=True) == []


def test_the_suite_is_what_its_source_writes(tmp_path: Path) -> None:
    """Its files do not change unless the format does. Video depends on the encoder's version, so the paper's codec is left out."""
    for case in ("predictive", "window"):
        write_case(case, tmp_path / case)
        for path in (HERE / case).rglob("*.safetensors"):
            assert path.read_bytes() == (tmp_path / case / path.relative_to(HERE / case)).read_bytes()


def test_the_format_names_each_case() -> None:
    section = (ROOT / "docs" / "format.md").read_text(encoding="utf-8").partition("# Conformance")[2]
    assert cases() == {name: covers for name, (covers, _) in CASES.items()}
    assert set(re.findall(r"`([\w-]+)`", section)) >= set(CASES)
