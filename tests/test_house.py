"""The rules of the house that a machine can check: the import ladder, sizes, and imports without side effects."""

import ast
import graphlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "splatreel"
PYTHON_FILES = sorted(p for d in ("src", "tests", "benchmarks") for p in (ROOT / d).rglob("*.py"))
LADDER = (
    ("base",),
    ("config", "scene"),
    ("storage", "kernels"),
    ("codec", "formats", "gpu", "capture"),
    ("calibration", "method", "play"),
    ("gsplat",),
    ("edit", "run", "segmentation"),
    ("evaluation",),
    ("importing",),
    ("api", "cli", "readers", "training"),
)
"""The rooms, from the lowest rung up; those of one rung do not import each other, except that all of the last rung may."""
RUNGS = {name: rung for rung, names in enumerate(LADDER) for name in names} | {
    "errors": 1,
    "progress": 1,
    "__main__": len(LADDER),
}
WITH_TORCH = {
    "calibration/learned_matches.py",
    "evaluation/perceptual.py",
    "method/images/flow.py",
    "method/layering/sam2.py",
    "play/timeline.py",
    "run/device_choice.py",
    "scene/gaussians.py",
}
"""Files that import torch inside of functions or for types: the networks of the extras `models` and `match`, and `to_torch`. Besides
them only the room `gsplat` may import it, and the choice of a device looks for it."""
MAX_FUNCTION_LINES = 80


def room_of(path: Path) -> str:
    """The first name below the package: the room, or the module if it lies in the package itself."""
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def module_name(path: Path) -> str:
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_names(tree: ast.AST) -> list[str]:
    """Full names of what a module imports, also inside its functions: `splatreel.scene.camera.Camera`."""
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}: write the full name"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def ladder_fault(room: str, imported: str) -> str | None:
    """Why a module of room may not import a name, or None if it may."""
    parts = imported.split(".")
    if parts[0] != "splatreel" or imported == "splatreel.__version__":
        return None
    if len(parts) < 2 or parts[1] not in RUNGS:
        return f"imports {imported}: import from the module that defines it"
    other = parts[1]
    mine, theirs = RUNGS[room], RUNGS[other]
    if theirs > mine or (theirs == mine and other != room):
        return f"is on rung {mine} and imports {imported} of rung {theirs}: imports only go down the ladder"
    return None


def test_the_ladder_judges_right() -> None:
    assert ladder_fault("run", "splatreel.method.images.flow.make_flow") is None
    assert ladder_fault("codec", "numpy") is None
    assert ladder_fault("codec", "splatreel.gpu.drawing.Drawing") is not None
    assert ladder_fault("scene", "splatreel.codec.reel") is not None
    assert ladder_fault("cli", "splatreel.open_reel") is not None


def test_imports_only_go_down_the_ladder() -> None:
    faults = []
    for path in SOURCE.rglob("*.py"):
        if path == SOURCE / "__init__.py":
            continue  # the public names, looked up late
        for name in imported_names(ast.parse(path.read_text(encoding="utf-8"))):
            fault = ladder_fault(room_of(path), name)
            if fault:
                faults.append(f"{path.relative_to(ROOT)} {fault}")
    assert not faults, "\n".join(faults)


def imports_within(room: Path) -> dict[str, set[str]]:
    """Return the imports among the folders and files of a room."""
    found: dict[str, set[str]] = {}
    prefix = [*module_name(room / "__init__.py").split(".")]
    for path in room.rglob("*.py"):
        mine = path.relative_to(room).parts[0].removesuffix(".py")
        others = found.setdefault(mine, set())
        for name in imported_names(ast.parse(path.read_text(encoding="utf-8"))):
            parts = name.split(".")
            if parts[: len(prefix)] == prefix and len(parts) > len(prefix) and parts[len(prefix)] != mine:
                others.add(parts[len(prefix)])
    return found


ROOMS = sorted({path.parent for path in SOURCE.glob("*/**/*.py")})


@pytest.mark.parametrize("room", ROOMS, ids=[str(room.relative_to(SOURCE)) for room in ROOMS])
def test_no_import_within_a_room_goes_in_a_circle(room: Path) -> None:
    assert sorter_of(imports_within(room)) is not None


def sorter_of(graph: dict[str, set[str]]) -> list[str]:
    """The nodes, each after those that it imports. Raises `CycleError`."""
    return list(graphlib.TopologicalSorter(graph).static_order())


def test_every_room_has_a_rung() -> None:
    rooms = {room_of(p) for p in SOURCE.rglob("*.py")} - {"__init__"}
    assert rooms == set(RUNGS)


def imported_at_the_top(tree: ast.Module) -> list[str]:
    """Full names of what a module imports when it is imported itself."""
    return imported_names(ast.Module([node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)], []))


def test_few_files_import_torch_and_only_inside_of_functions() -> None:
    inside, at_the_top = set(), set()
    for path in SOURCE.rglob("*.py"):
        if room_of(path) == "gsplat":
            continue
        tree, name = ast.parse(path.read_text(encoding="utf-8")), path.relative_to(SOURCE).as_posix()
        if {full.split(".")[0] for full in imported_names(tree)} & {"torch", "torchvision", "gsplat", "kornia"}:
            inside.add(name)
        if {full.split(".")[0] for full in imported_at_the_top(tree)} & {"torch", "torchvision", "gsplat", "kornia"}:
            at_the_top.add(name)
    assert not at_the_top
    assert inside <= WITH_TORCH


def test_gsplat_is_imported_by_the_choice_of_a_device_only() -> None:
    found = set()
    for path in SOURCE.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if room_of(path) != "gsplat" and any(name.startswith("splatreel.gsplat") for name in imported_names(tree)):
            assert not any(name.startswith("splatreel.gsplat") for name in imported_at_the_top(tree)), path
            found.add(path.relative_to(SOURCE).as_posix())
    assert found <= {"run/device_choice.py"}


def test_functions_fit_a_screen() -> None:
    long = {}
    for path in PYTHON_FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                if lines > MAX_FUNCTION_LINES:
                    long[f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"] = lines
    assert not long, f"longer than {MAX_FUNCTION_LINES} lines: {long}"


def test_room_inits_hold_no_logic() -> None:
    """A docstring; that of `config` also shows the names of its own files, which everything imports."""
    for path in SOURCE.glob("*/**/__init__.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            shown = isinstance(node, ast.ImportFrom) and str(node.module).startswith("splatreel.config.")
            listed = isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
            document = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            assert document or (path.parent == SOURCE / "config" and (shown or listed)), path
    assert not list(SOURCE.rglob("utils.py"))


def tracked_text_files() -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    suffixes = {".py", ".md", ".ts", ".js", ".html", ".css", ".toml", ".txt", ".json", ".jsonl", ".yml", ""}
    paths = [ROOT / name for name in listed.stdout.split("\0") if name]
    return [p for p in paths if p.suffix in suffixes and p.is_file() and "static" not in p.parts]


def test_nothing_is_left_to_do_and_no_path_of_one_machine_is_named() -> None:
    unfinished = re.compile(r"\b(TO" + r"DO|FIX" + r"ME|XX" + r"X)\b")
    one_machine = re.compile(r"(?<![\w.>~-])/(home|root|work|mnt|Users)/\w")
    found = []
    for path in tracked_text_files():
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
            if unfinished.search(line) or one_machine.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}")
    assert not found, "\n".join(found)


def test_sentences_have_the_word_order_of_english() -> None:
    """No "X is no file" in place of "X is not a file", and no "from which on"."""
    odd = re.compile(r"\b(?:is|are) no (?!longer\b)[a-z]|\bfrom which on\b|\bthe own \b", re.IGNORECASE)
    dated = {ROOT / "docs" / "history", ROOT / "docs" / "experiments"}
    found = []
    for path in tracked_text_files():
        if (
            path.suffix in (".py", ".md")
            and not dated & {*path.parents}
            and "tests" not in path.relative_to(ROOT).parts
        ):
            text = re.sub(r"(?i)\bthere\s+(?:is|are)\s+no\b", "", path.read_text(encoding="utf-8"))
            found += [f"{path.relative_to(ROOT)}: {match[0]}" for match in odd.finditer(text)]
    assert not found, "\n".join(found)


IMPORT_ALL = """
import importlib, json, sys, threading
seen = {}
for name in json.loads(sys.argv[1]):
    importlib.import_module(name)
    if "torch" in sys.modules and "torch" not in seen:
        seen["torch"] = name
print(json.dumps({"torch": seen.get("torch"), "threads": threading.active_count()}))
"""


def test_imports_are_quiet_and_load_no_torch(tmp_path: Path) -> None:
    """Importing every module but those of `gsplat` prints nothing, writes nothing, starts no thread and does not load torch."""
    modules = [module_name(p) for p in sorted(SOURCE.rglob("*.py")) if room_of(p) != "gsplat"]
    command = [sys.executable, "-c", IMPORT_ALL, json.dumps(["splatreel", *modules])]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert json.loads(result.stdout) == {"torch": None, "threads": 1}
    assert list(tmp_path.iterdir()) == []


def test_version_is_stated_once_and_the_same() -> None:
    import tomllib

    import splatreel

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == splatreel.__version__
    assert f"## {splatreel.__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_paper_map_names_what_exists() -> None:
    named = re.findall(r"`([\w/]+\.py):(\w+)`", (ROOT / "docs" / "paper-map.md").read_text(encoding="utf-8"))
    assert len(named) > 20
    missing = []
    for file, name in named:
        path = (ROOT if file.startswith("benchmarks/") else SOURCE) / file
        body = ast.parse(path.read_text(encoding="utf-8")).body if path.exists() else []
        if name not in [n.name for n in body if isinstance(n, ast.FunctionDef | ast.ClassDef)]:
            missing.append(f"{file}:{name}")
    assert not missing


RELATIVE = {"What", "How", "Of", "As", "By", "Where", "That", "Who", "Which", "Whether", "Whatever", "Whoever"}
"""Words that start a relative clause or an answer without its question."""


def test_docstrings_are_not_relative_clauses() -> None:
    """A docstring starts with a verb or a noun phrase, never with "What" or "How"."""
    found = []
    for path in [*PYTHON_FILES, *(ROOT / "examples").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                words = (ast.get_docstring(node) or "").split()
                if words and words[0].strip(",.:") in RELATIVE:
                    found.append(f"{path.relative_to(ROOT)}: {' '.join(words[:6])}")
    assert not found


def test_titles_of_the_players_tests_are_not_relative_clauses() -> None:
    titles = re.compile(r"""^\s*test\(\s*["'`](\w+)""", re.MULTILINE)
    found = [
        f"{path.relative_to(ROOT)}: {word}"
        for path in (ROOT / "player" / "tests").rglob("*.ts")
        for word in titles.findall(path.read_text(encoding="utf-8"))
        if word.capitalize() in RELATIVE
    ]
    assert not found
