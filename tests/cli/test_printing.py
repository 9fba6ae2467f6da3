"""Printed text: no control sequences, and commands that can be copied."""

from pathlib import Path

import pytest

from splatreel.base.progress import printable
from splatreel.cli.printing import say, serving


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain, naïve, 魚, a\u00a0b\n\tand more", "plain, naïve, 魚, a\u00a0b\n\tand more"),
        ("\x1b[2J", r"\x1b[2J"),
        ("\x1b]0;title\x07", r"\x1b]0;title\x07"),
        ("one\rtwo", r"one\rtwo"),
        ("\x9b31m", r"\x9b31m"),
        ("exe.\u202egpj", r"exe.\u202egpj"),
        ("\ud800", r"\ud800"),
    ],
)
def test_printable(text: str, shown: str) -> None:
    assert printable(text) == shown


def test_say(capsys: pytest.CaptureFixture[str]) -> None:
    say("a\x1b[31m", end="!\n")
    assert capsys.readouterr().out == "a\\x1b[31m!\n"


def test_serve_command_is_quoted_for_the_shell() -> None:
    assert serving(Path("my run/reel")) == 'splatreel serve "my run/reel"'
