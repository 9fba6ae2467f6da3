"""Commands and names between backticks in the documents: commands parse, and names occur in the code."""

import contextlib
import functools
import io
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import tyro

from splatreel.cli.main import GROUPS, VERBS, join_lines

ROOT = Path(__file__).parents[2]
DATED = (ROOT / "docs" / "history", ROOT / "docs" / "experiments")
"""Documents that keep the names of their time, besides the changelog."""
FOLDERS = ("docs", "examples", "player", "src", "deploy", "benchmarks")
SKIPPED = {"node_modules", "dist", ".venv", "out"}
DOCUMENTS = [
    path
    for path in sorted([*ROOT.glob("*.md"), *(path for name in FOLDERS for path in (ROOT / name).rglob("*.md"))])
    if not any(folder in path.parents for folder in DATED)
    and not SKIPPED & {*path.parts}
    and path.name != "CHANGELOG.md"
]
BLOCK = re.compile(r"^```[^\n]*\n.*?^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
OTHERS = {"--version", "--help", "VERB"}
"""First words after `splatreel` that are no verbs."""


def commands(text: str) -> Iterator[tuple[str, bool]]:
    """Yield the `splatreel` commands of a document without the name of the program, and whether they stand in a block of code."""
    lines = [line.removeprefix("    ") for line in text.splitlines() if line.startswith("    ")]
    lines += [line for block in BLOCK.findall(text) for line in block.splitlines()]
    for line in re.sub(r"\\\n\s*", " ", "\n".join(lines)).splitlines():
        if found := re.match(r"(?:\w+=\S+ )*(?:\.venv/bin/)?splatreel ([^#|&;]*)", line.strip()):
            yield found[1].strip(), True
    for code in INLINE.findall(re.sub(r"\s*\n\s*", " ", BLOCK.sub("", text))):
        first = code.split(" ")[0]
        if found := re.fullmatch(r"(?:\.venv/bin/)?splatreel (.*)", code):
            yield found[1], False
        elif (first in VERBS or first in GROUPS) and re.search(r" (--|[A-Z]{3}|\w+ [A-Z]{3})", code):
            yield code, False


def verb_of(words: list[str]) -> str | None:
    """Return the verb that a command begins with; None if there is none."""
    found = " ".join(words[: 2 if words[:1] and words[0] in GROUPS else 1])
    return found if found in VERBS else None


def problem(command: str, whole: bool, helps: dict[str, str]) -> str | None:
    """Return what is wrong with a command. A command within a sentence may leave out arguments.

    Args:
        command: The command without the name of the program.
        whole: True to parse it as the command line does.
        helps: Help of the verbs, which is filled.
    """
    words = [word for word in shlex.split(command) if word not in ("...", "…")]
    verb = verb_of(words)
    if verb is None:
        return None if words[0] in OTHERS or (words == [words[0]] and words[0] in GROUPS) else "there is no such verb"
    arguments = words[len(verb.split()) :]

    @functools.wraps(VERBS[verb])
    def nothing(*_: Any, **__: Any) -> None: ...

    if whole:
        try:
            tyro.cli(nothing, args=arguments, prog=verb, console_outputs=False)
        except SystemExit:
            return "it does not parse"
        return None
    if verb not in helps:
        join_lines(VERBS[verb])
        with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.suppress(SystemExit):
            tyro.cli(nothing, args=["--help"], prog=verb)
        helps[verb] = text.getvalue()
    unknown = [word for word in arguments if word.startswith("--") and word.split("=")[0] not in helps[verb]]
    return f"{unknown[0]} is unknown" if unknown else None


def test_commands_of_the_documents_exist() -> None:
    helps: dict[str, str] = {}
    found = {
        (path.relative_to(ROOT).as_posix(), *one) for path in DOCUMENTS for one in commands(path.read_text("utf-8"))
    }
    assert len(found) > 100
    known = {one: problem(*one, helps) for one in {(command, whole) for _, command, whole in found}}
    wrong = [
        f"{path}: `{command}`: {known[command, whole]}"
        for path, command, whole in sorted(found)
        if known[command, whole]
    ]
    assert wrong == []


def test_false_commands_are_found() -> None:
    text = "    splatreel capture paper CAPTURE --out OUT\n\nCall `capture film OUT --tables` or `splatreel capture`.\n"
    text += "\n```\n.venv/bin/splatreel edit REEL --titel x  # text\n```\n`splatreel reconstruct --estimate`\n"
    found = {command: problem(command, whole, {}) for command, whole in commands(text)}
    assert found == {
        "capture paper CAPTURE --out OUT": "there is no such verb",
        "capture film OUT --tables": "--tables is unknown",
        "capture": None,
        "edit REEL --titel x": "it does not parse",
        "reconstruct --estimate": None,
    }


@functools.cache
def words_of_the_code() -> frozenset[str]:
    """Return all words of the code, of its settings and of its tools, and the names of all files."""
    found = set()
    kinds = {
        ".py",
        ".ts",
        ".mjs",
        ".js",
        ".jsx",
        ".tsx",
        ".wgsl",
        ".toml",
        ".yml",
        ".json",
        ".html",
        ".css",
        ".txt",
        "",
    }
    folders = ("src", "player", "tests", "benchmarks", "examples", "deploy", "conformance", ".ci", ".github")
    files = [path for path in ROOT.iterdir() if path.is_file()]
    for name in folders:
        for path in (ROOT / name).rglob("*"):
            if not SKIPPED & {*path.relative_to(ROOT).parts} and path.is_file():
                files.append(path)
    for path in files:
        found |= {path.name, path.stem, *path.relative_to(ROOT).parts}
        if path.suffix in kinds and path.name != Path(__file__).name and path.stat().st_size < 1_000_000:
            found |= set(re.findall(r"[A-Za-z_]\w*", path.read_text(encoding="utf-8", errors="replace")))
    return frozenset(found)


def names(text: str) -> Iterator[str]:
    """Yield the words between backticks that can only be names of code or files: with an underscore, inner capitals, or an ending."""
    for code in INLINE.findall(BLOCK.sub("", text)):
        if re.search(r"[\s=]", code):
            continue
        for word in re.findall(r"[\w-]+\.(?:py|ts|mjs|wgsl|toml|js)\b|[A-Za-z_]\w*", code):
            if re.search(r"\w_\w|[a-z][A-Z]|\.", word):
                yield word


FOREIGN = {
    *("NAME.py", "NAME.ts", "test_NAME.py", "utils.py", "vVERSION", "cam_N", "cam00.ts", "decoder.js"),
    *("AudioDecoder", "decodeAudioData", "CameraFrame", "GSplatProcessor", "antiAlias", "from_gltf", "from_usd"),
    *(
        "camera_array.toml",
        "NAME_camera_calibration.toml",
        "camera_data.py",
        "nerfstudio_dataparser.py",
        "export_perframe_3DGS.py",
    ),
    *("control_x_", "motion_xyz_", "rot_r_", "transforms_val", "DGV_DeskGames", "MeshPhysicalMaterial"),
}
"""Names of other programs, and placeholders."""


def unknown_names(text: str) -> set[str]:
    return {name for name in names(text) if name not in words_of_the_code() and name not in FOREIGN}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_names_of_the_documents_occur_in_the_code(document: Path) -> None:
    assert sorted(unknown_names(document.read_text(encoding="utf-8"))) == []


def test_false_names_are_found() -> None:
    text = "`why_never`, `kernels/translations.py`, `Camera.projectAll`, `no_such()`; but `word`, `kernels/motion.py`, `Camera`"
    assert unknown_names(text) == {"why_never", "translations.py", "projectAll", "no_such"}
