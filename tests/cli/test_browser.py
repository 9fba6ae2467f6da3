"""Browsers are opened in windows only."""

import sys
import threading

import pytest

from splatreel.cli.browser import has_browser, open_browser

WINDOWS = ("BROWSER", "DISPLAY", "WAYLAND_DISPLAY", "WSL_DISTRO_NAME")


@pytest.fixture(autouse=True)
def linux(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr("webbrowser.get", lambda: None)
    for name in WINDOWS:
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize("name", WINDOWS)
def test_a_window_or_a_chosen_browser_is_enough(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    assert not has_browser(), "a browser in the terminal would take it over"
    monkeypatch.setenv(name, "something")
    assert has_browser()


def test_without_a_browser_nothing_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("webbrowser.open", lambda url: pytest.fail("opened"))
    assert not open_browser("http://localhost/")


def test_opening_does_not_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, ended = threading.Event(), threading.Event()

    def start(url: str) -> None:
        begun.set()
        ended.wait(60)

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", start)
    assert open_browser("http://localhost/")
    assert begun.wait(60)
    ended.set()
