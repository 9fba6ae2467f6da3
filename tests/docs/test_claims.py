"""Claims of the documents about files: the files exist, and the names that they are said to hold are defined in them."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "splatreel"
DATED = (ROOT / "docs" / "history", ROOT / "docs" / "experiments")
"""Documents that keep the names of their time."""
DOCUMENTS = [
    path
    for path in sorted([*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md"), *(ROOT / "player").glob("*.md")])
    if not any(folder in path.parents for folder in DATED) and path.name != "CHANGELOG.md"
]
FILE = r"[\w./-]+\.(?:py|ts|mjs|toml|yml)"
IN = re.compile(rf"`([A-Za-z_][\w.]*)`(?: and `([A-Za-z_][\w.]*)`)?\s+(?:in|of)\s+`({FILE})`")
WITH = re.compile(rf"`({FILE})`\s+\((?:the \w+ )?`([A-Za-z_][\w.]*)`\)")
COLON = re.compile(rf"`({FILE}):([A-Za-z_][\w.]*)`")
PATHS = re.compile(r"`((?:[\w-]+/)+[\w.-]+\.(?:py|ts|mjs|md|toml|yml))`")
EXAMPLES = {
    *("NAME.py", "test_NAME.py", "NAME.ts", "YYYY-MM-DD-name.md"),
    *("camera_array.toml", "NAME_camera_calibration.toml"),
}
"""File names in recipes that stand for others, and files of other programs."""


def claims(text: str) -> set[tuple[str, str]]:
    """Return (name, file) for each name that a text places in a file."""
    found = {(name, file) for *names, file in IN.findall(text) for name in names if name}
    return found | {(name, file) for file, name in (*WITH.findall(text), *COLON.findall(text))}


def located(file: str) -> list[Path]:
    """Return the files that a document can mean: by their path in the package or the repository, or by the end of it."""
    exact = [base / file for base in (SOURCE, ROOT, ROOT / "player") if (base / file).is_file()]
    if exact:
        return exact
    folders = (SOURCE, ROOT / "player" / "src", ROOT / "player" / "packages", ROOT / "tests", ROOT / "benchmarks")
    return [path for base in folders for path in base.rglob(file) if "node_modules" not in path.parts]


def defined(path: Path) -> set[str]:
    """Return the names of a Python file's classes, functions, constants, methods and fields; of other files, all words."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return set(re.findall(r"[A-Za-z_][\w-]*", text))
    names: set[str] = set()

    def collect(body: list[ast.stmt], owner: str) -> None:
        for node in body:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                names.update((node.name, owner + node.name))
                if isinstance(node, ast.ClassDef):
                    collect(node.body, f"{node.name}.")
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                found = {leaf.id for target in targets for leaf in ast.walk(target) if isinstance(leaf, ast.Name)}
                names.update(found | {owner + name for name in found})

    collect(ast.parse(text).body, "")
    return names


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_names_are_defined_in_the_files_that_documents_name(document: Path) -> None:
    false = []
    for name, file in sorted(claims(document.read_text(encoding="utf-8"))):
        if not any(name in defined(path) for path in located(file)):
            false.append(f"`{name}` in `{file}`")
    assert not false


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_files_that_documents_name_exist(document: Path) -> None:
    named = set(PATHS.findall(document.read_text(encoding="utf-8")))
    kept = {file for file in named if Path(file).name not in EXAMPLES}
    folders = (ROOT / "docs", document.parent, ROOT / "tests")
    assert sorted(f for f in kept if not located(f) and not any((base / f).exists() for base in folders)) == []


def test_claims_of_each_form_are_found() -> None:
    text = "`A` and `b_c` in `x/y.py`; `LIST`\nof `z.ts`; `x/y.py:Class.method`; `x/y.py` (the list `GROUP`); `word` in a file"
    assert claims(text) == {
        *(("A", "x/y.py"), ("b_c", "x/y.py"), ("LIST", "z.ts")),
        *(("Class.method", "x/y.py"), ("GROUP", "x/y.py")),
    }


def test_false_claims_are_found(tmp_path: Path) -> None:
    file = tmp_path / "module.py"
    file.write_text(
        "import os\nLEAST: int = 3\n\n\nclass Box:\n    side = 1\n\n    def open(self): ...\n", encoding="utf-8"
    )
    assert {"LEAST", "Box", "Box.side", "Box.open", "open"} <= defined(file)
    assert not {"os", "int", "self", "Box.close"} & defined(file)
