"""Which statements of the package the tests run: each block of statements raises a flag of its own as it begins.

The tracer of the coverage package makes these tests half as slow again on Python 3.11; flags cost next to nothing. Not counted are
what numba compiles, which must stay as it is, and what runs in other processes.
"""

import ast
import importlib.abc
import importlib.machinery
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

PACKAGE = Path(__file__).parent.parent / "src" / "splatreel"
FLAGS = "__blocks_that_ran__"
BLOCKS = ("body", "orelse", "finalbody")
BRANCHES = (ast.If, ast.For, ast.While, ast.Try, ast.TryStar, ast.With, ast.Match, ast.AsyncFor, ast.AsyncWith)


class Source:
    """A module's code with flags, the lines of the statements that each of these stands for, and the flags."""

    def __init__(self, path: Path) -> None:
        self.lines: list[list[int]] = []
        tree = ast.parse(path.read_bytes())
        tree.body = self._flagged(tree.body)
        self.code = compile(ast.fix_missing_locations(tree), str(path), "exec", dont_inherit=True)
        self.flags = bytearray(len(self.lines))

    def _flagged(self, body: list[ast.stmt]) -> list[ast.stmt]:
        """The statements, with a flag before the first and after each that may not go on to the next."""
        found: list[ast.stmt] = []
        together: list[int] | None = None
        for node in body:
            if not _counts(node):
                found.append(node)
                continue
            if together is None:
                flag = ast.parse(f"{FLAGS}[{len(self.lines)}] = 1").body[0]
                found.append(ast.increment_lineno(flag, node.lineno - 1))
                self.lines.append(together := [])
            together.append(node.lineno)
            self._enter(node)
            found.append(node)
            if isinstance(node, BRANCHES):
                together = None
        return found

    def _enter(self, node: ast.AST) -> None:
        if any("njit" in ast.unparse(decorator) for decorator in getattr(node, "decorator_list", [])):
            return
        for name in BLOCKS:
            if isinstance(body := getattr(node, name, None), list):
                setattr(node, name, self._flagged(body))
        for part in (*getattr(node, "handlers", []), *getattr(node, "cases", [])):
            part.body = self._flagged(part.body)

    def missed(self) -> list[int]:
        """Lines of the statements that did not run."""
        return [line for lines, ran in zip(self.lines, self.flags, strict=True) if not ran for line in lines]


def _counts(node: ast.stmt) -> bool:
    """No docstring, no ellipsis, nothing for type checkers alone, and none of what must stand at the top of a file."""
    if isinstance(node, ast.ImportFrom) and node.module == "__future__":
        return False
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return False
    return not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))


class Coverage(importlib.abc.MetaPathFinder):
    """Loads the package with flags, from when it is put into `sys.meta_path`."""

    def __init__(self) -> None:
        self.sources: dict[Path, Source] = {}

    def source(self, path: Path) -> Source:
        if path not in self.sources:
            self.sources[path] = Source(path)
        return self.sources[path]

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name.partition(".")[0] != PACKAGE.name:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is not None and isinstance(spec.loader, importlib.machinery.SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path, self)
        return spec

    def missed(self) -> dict[str, list[int]]:
        """By file of the package: lines of the statements that did not run."""
        paths = sorted(PACKAGE.rglob("*.py"))
        return {path.relative_to(PACKAGE).as_posix(): self.source(path).missed() for path in paths}

    def summary(self) -> str:
        missed = sum(len(lines) for lines in self.missed().values())
        total = sum(len(lines) for source in self.sources.values() for lines in source.lines)
        return f"Python coverage: {100 * (total - missed) / total:.0f} % of {total} statements (in this process, without kernels)"


class _Loader(importlib.machinery.SourceFileLoader):
    def __init__(self, name: str, path: str, coverage: Coverage) -> None:
        super().__init__(name, path)
        self.source = coverage.source(Path(path))

    def get_code(self, fullname: str) -> Any:
        return self.source.code

    def exec_module(self, module: ModuleType) -> None:
        setattr(module, FLAGS, self.source.flags)
        super().exec_module(module)


def start() -> Coverage:
    """Count from now on; nothing of the package may have been imported yet."""
    assert PACKAGE.name not in sys.modules
    coverage = Coverage()
    sys.meta_path.insert(0, coverage)
    return coverage
