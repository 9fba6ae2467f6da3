"""Command lines in messages, for the shells of all systems."""

import re
import subprocess
from pathlib import Path

import pytest

from splatreel.base.command_line import install_command, quoted

ROOT = Path(__file__).parent.parent
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
]


@pytest.mark.parametrize("name", NAMES)
def test_posix_shells_read_the_name(name: str) -> None:
    line = quoted(["printf", "%s", name], windows=False)
    assert subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=True).stdout == name


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
