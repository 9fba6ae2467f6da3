"""The Python reader and @splatreel/decoder refuse the same mutated reels."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from conformance.run import refusal_of

from tests.codec.mutations import mutations
from tests.codec.test_conformance import ROOT


@pytest.mark.slow
def test_both_readers_refuse_the_same_reels(tmp_path: Path) -> None:
    if shutil.which("node") is None:
        pytest.skip("needs node")
    names = {f"{number:04d}": name for number, name in enumerate(mutations())}
    reels = mutations()
    for number, name in names.items():
        reels[name].write(tmp_path / number)
    command = ["node", "fuzz/verdicts.mjs", tmp_path]
    ended = subprocess.run(command, cwd=ROOT / "player", capture_output=True, text=True, timeout=1800)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    own = {number: refusal_of(tmp_path / number) for number in names}
    differ = {n: (own[i], found[i]) for i, n in names.items() if (own[i] is None) != (found[i] is None)}
    assert differ == {}
    refused = sum(value is not None for value in own.values())
    assert len(names) > 2000
    assert 0.5 < refused / len(names) < 0.95
