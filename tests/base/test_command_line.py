"""Command lines in messages, for the shells of all systems."""

import ast
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from splatreel.base.command_line import install_command, option, quoted
from splatreel.base.progress import printable

ROOT = Path(__file__).parents[2]
NAMES = [
    "reel",
    "my reel",
    "it's",
    "a&b",
    "100%",
    "$HOME",
    'say "hi"',
    "back`tick",
    "C:\\reels\\a b",
    "ümlaut",
    "",
    "wow!",
    "=ls",
    "~root",
    "*",
    "{a,b}",
    "#note",
    "a;b|c>d",
    "(a)",
    "a\u00a0b",
]
ODD_NAMES = [
    "two\nlines",
    "tab\tbed",
    "esc\x1b[2J'\\!",
    "right to left \u202etxt",
    os.fsdecode(b"caf\xe9 1"),
    os.fsdecode(b"\xff0"),
]
"""Names that a message cannot show as they are."""


@pytest.mark.parametrize("name", NAMES)
def test_posix_shells_read_the_name(name: str) -> None:
    line = quoted(["printf", "%s", name], windows=False)
    assert subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=True).stdout == name


@pytest.mark.parametrize("name", [*NAMES, *ODD_NAMES])
def test_any_name_can_be_pasted(name: str) -> None:
    """Messages show only characters that can be printed, in one line."""
    if (shell := shutil.which("bash")) is None:
        pytest.skip("bash is not installed")
    line = quoted(["printf", "%s", name], windows=False)
    assert "\n" not in line
    assert printable(line) == line
    assert subprocess.run([shell, "-c", line], capture_output=True, check=True).stdout == os.fsencode(name)


def test_names_that_start_with_a_dash_are_no_options() -> None:
    assert quoted(["splatreel", "serve", Path("-reel"), Path("a/-b"), "--port", 1]) == (
        "splatreel serve ./-reel a/-b --port 1"
    )
    assert quoted([Path("-my reel")], windows=False) == '"./-my reel"'
    assert option("--leave-out", "cam01") == ["--leave-out", "cam01"]
    assert option("--leave-out", "-1") == ["--leave-out=-1"]


def test_commands_in_messages_are_quoted() -> None:
    """A value that is written into a command without `quoted` breaks it if it holds a blank."""
    numbers = re.compile(r"width|quality|fits|first|in_megabytes|gibibytes")
    found = []
    for file in sorted((ROOT / "src").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.JoinedStr):
                continue
            text = "".join(
                str(part.value) if isinstance(part, ast.Constant) else f"\0{ast.unparse(part.value)}\0"
                for part in node.values
                if isinstance(part, ast.Constant) or (isinstance(part, ast.FormattedValue) and part.conversion == -1)
            )
            commands = re.findall(r"splatreel [a-z][^\0`.]*\0([^\0]*)\0", text)
            commands += re.findall(r"--(?:leave-out|hold-out|distance|allow-host|width|frames)[ =]\0([^\0]*)\0", text)
            found += [f"{file.relative_to(ROOT)}: {value}" for value in commands if not numbers.search(value)]
    # The name of a host has been checked.
    assert found == ["src/splatreel/play/web_app.py: name"]


def test_a_blank_needs_double_quotes_everywhere() -> None:
    assert quoted(["splatreel", "serve", Path("my reel")], windows=False) == 'splatreel serve "my reel"'
    assert quoted(["splatreel", "serve", Path("my reel")], windows=True) == 'splatreel serve "my reel"'


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("C:\\reels\\room", "C:\\reels\\room"),
        ("C:\\my reels\\", '"C:\\my reels\\\\"'),
        ("a&b", '"a&b"'),
        ("it's", '"it\'s"'),
        ('say "hi"', '"say \\"hi\\""'),
    ],
)
def test_windows_shells_read_the_name(name: str, written: str) -> None:
    """The backslashes are those of the rules by which C programs on Windows split a command line."""
    assert quoted([name], windows=True) == written


def test_install_command() -> None:
    assert install_command("cloud", "s3fs") == 'pip install "splatreel[cloud]" s3fs'


def test_documented_commands_have_no_single_quotes() -> None:
    """cmd.exe takes single quotes as a part of the name."""
    files = [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / "examples").glob("*.md"),
    ]
    files += [*(ROOT / "src").rglob("*.py"), *(ROOT / "examples").glob("*.py"), ROOT / "player" / "README.md"]
    command = re.compile(r"(pip install|splatreel [a-z]+|python examples/\S+) [^\n#`]*'[^'\n]*'")
    found = [
        f"{file.relative_to(ROOT)}: {match[0]}"
        for file in files
        for match in command.finditer(file.read_text(encoding="utf-8"))
        if "\n" not in match[0]
    ]
    assert not found
