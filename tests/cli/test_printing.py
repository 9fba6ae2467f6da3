"""Printed text: no control sequences, and commands that can be copied."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from splatreel.base.progress import printable
from splatreel.cli.printing import print_qr_code, qr_code, say, serving


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


LINK = "http://192.168.178.123:8080/self-test.html"
LIGHT = {" ": (0, 0), "▀": (1, 0), "▄": (0, 1), "█": (1, 1)}


def test_a_reader_finds_the_text() -> None:
    lines = qr_code(LINK).splitlines()
    halves = np.array([[LIGHT[block] for block in line] for line in lines])
    modules = halves.transpose(0, 2, 1).reshape(2 * len(lines), -1)
    image = np.kron(modules, np.full((8, 8), 255)).astype(np.uint8)
    assert cv2.QRCodeDetector().detectAndDecode(image)[0] == LINK


class Terminal(io.TextIOWrapper):
    """A terminal of an encoding."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("encoding", "shown"), [("utf-8", True), ("cp1252", False)])
def test_a_terminal_shows_the_code_if_it_has_block_characters(
    monkeypatch: pytest.MonkeyPatch, encoding: str, shown: bool
) -> None:
    terminal = Terminal(io.BytesIO(), encoding)
    monkeypatch.setattr(sys, "stdout", terminal)
    print_qr_code(LINK)
    terminal.flush()
    written = terminal.buffer.getvalue().decode(encoding)  # pyright: ignore[reportAttributeAccessIssue]
    assert ("█" in written) is shown


def test_nothing_is_printed_into_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    print_qr_code(LINK)
    assert capsys.readouterr().out == ""
