"""Progress bars in notebooks, with a stand-in for IPython."""

import sys
from types import SimpleNamespace
from typing import Any

import pytest

from splatreel.base.display import NotebookBars, console


class Cell:
    """Output of a cell: all displays, each as its last content."""

    def __init__(self) -> None:
        self.shown: list[dict[str, str]] = []

    def display(self, data: dict[str, str], raw: bool, display_id: bool = False) -> Any:
        assert raw
        self.shown.append(data)
        place = len(self.shown) - 1

        def update(data: dict[str, str], raw: bool) -> None:
            self.shown[place] = data

        return SimpleNamespace(update=update)


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Cell:
    made = Cell()
    shell = SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=made.display))
    return made


def test_a_notebook_shows_a_bar_for_each_stage(cell: Cell) -> None:
    bars = console()
    assert isinstance(bars, NotebookBars)
    bars.stage("keyframe <1>", 10)
    bars.update(5, psnr=29.1)
    bars.note("a remark")
    bars.update(10, psnr=30.0)
    bars.stage("motion", 4)
    bars.update(1)
    bars.close()
    first, remark, second = cell.shown
    assert first["text/plain"].startswith("keyframe <1>: done in")
    assert "30.0 dB" in first["text/html"]
    assert "keyframe &lt;1&gt;" in first["text/html"]
    assert 'value="1.000"' in first["text/html"]
    assert remark == {"text/plain": "a remark"}
    assert "25 %" in second["text/plain"]


def test_a_terminal_with_ipython_is_no_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: SimpleNamespace()))
    assert not isinstance(console(), NotebookBars)
