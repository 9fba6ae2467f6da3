"""Every command where the terminal has few characters: in a locale without UTF-8 and on cp1252, with names that it cannot show."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.importing.films import frame, write_film

GOLDEN = Path(__file__).parent.parent / "data" / "golden-predictive"
NAME = "Küche \u9b5a"
SETTINGS = {
    "C": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "cp1252": {"PYTHONIOENCODING": "cp1252:strict"},
}
ALL = """
import itertools, sys
from splatreel.cli.main import main

for command, arguments in itertools.groupby(sys.argv[1:], lambda argument: argument != "---"):
    if command:
        name, *rest = arguments
        print("code", main([name, *rest]), name, flush=True)
"""
"""Runs commands that are set apart by `---`, in one process: each argument comes as the system gives it."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reel and a film in a folder whose name few terminals have."""
    place = tmp_path_factory.mktemp("locale") / NAME
    shutil.copytree(GOLDEN, place / "reel")
    write_film(place / "film", [frame(0)])
    return place


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="locales")
@pytest.mark.parametrize("setting", SETTINGS)
def test_commands_print_in_any_locale(folder: Path, setting: str, tmp_path: Path) -> None:
    reel, film, out = str(folder / "reel"), str(folder / "film"), str(tmp_path / NAME)
    author = NAME if setting != "C" else "Kueche"  # bytes that are no text there are refused as such
    done = [
        ["info", reel],
        ["verify", reel],
        ["config"],
        ["edit", reel, "--author", author],
        ["publish", reel, out],
        ["import", film, "--out", f"{out} imported", "--title", author],
        ["export", reel, "--out", f"{out}.html"],
        ["export", reel, "--out", f"{out} frames"],
        ["export", reel, "--out", f"{out}.mp4", "--width", "32"],
    ]
    missing = str(folder / "nothing")
    failing = [
        ["capture", "check", missing],
        ["capture", "calibrate", missing],
        ["capture", "sync", missing],
        ["reconstruct", missing, "--out", out],
        ["encode", missing, "--out", f"{out} encoded"],
        ["evaluate", missing, missing, "--out", out],
        ["view", missing],
        ["serve", missing],
    ]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | SETTINGS[setting]
    arguments = [argument for one in (*done, *failing) for argument in (*one, "---")]
    command = [sys.executable, "-c", ALL, *arguments]
    ended = subprocess.run(command, capture_output=True, env=environment)
    said, errors = ended.stdout.decode("latin-1"), ended.stderr.decode("latin-1")
    assert ended.returncode == 0, errors
    assert "Traceback" not in errors
    codes = [line.split()[1:] for line in said.splitlines() if line.startswith("code ")]
    assert codes[: len(done)] == [["0", arguments[0]] for arguments in done], errors
    assert [code for code, _ in codes[len(done) :]] == ["1"] * len(failing), errors
    assert (r"\u9b5a" if setting != "C" else r"\udce9") in said
    assert (tmp_path / f"{NAME}.mp4").exists()
