import json
import re
from pathlib import Path

import pytest

from profiled import profiled, table
from splatreel.base.errors import CaptureError
from splatreel.capture import opening
from splatreel.cli.main import main
from tests.evaluation import scenes
from tests.method.small import FEW


def test_profile_lists_longest_functions_first() -> None:
    calls = {
        ("/x/splatreel/kernels/a.py", 7, "slow"): (2, 4, 3.0, 3.5, {}),
        ("~", 0, "<built-in sum>"): (1, 1, 0.99, 0.99, {}),
        ("/x/other.py", 1, "quick"): (9, 9, 0.01, 4.0, {}),
    }
    text = table(calls)
    assert text.startswith("4.0 s on the main thread.")
    assert "| 75.0% | 3.00 | 4 | 750.000 | 3.50 | `kernels/a.py:7` `slow` |" in text
    assert "| 24.8% | 0.99 | 1 | 990.000 | 0.99 | `<built-in sum>` |" in text
    assert text.index("slow") < text.index("sum")
    assert "quick" not in text


def test_profile_is_written_after_an_error(tmp_path: Path) -> None:
    path = tmp_path / "profile.md"
    capture = scenes.capture(tmp_path, ["cam03"])
    with pytest.raises(CaptureError), profiled(path):
        capture.read(99, 1, ["cam00"])
    assert re.search(r"\| \d", path.read_text())
    assert [p.name for p in tmp_path.iterdir()] == ["profile.md"]


def test_profile_creates_no_folder(tmp_path: Path) -> None:
    with profiled(tmp_path / "no" / "profile.md"):
        pass
    assert not (tmp_path / "no").exists()


@pytest.mark.slow
def test_a_reconstruction_is_profiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = scenes.capture(tmp_path, ["cam03"])
    monkeypatch.setattr(opening, "open_capture", lambda *_, **__: capture)
    sizes = [f"--set={name}={json.dumps(value)}" for name, value in FEW.items()]
    with profiled(tmp_path / "profile.md"):
        assert main(["reconstruct", "capture", "--out", str(tmp_path / "out"), *sizes]) == 0
    said = (tmp_path / "profile.md").read_text()
    assert "s on the main thread" in said
    assert "`kernels/" in said, "where the time of any training goes"
