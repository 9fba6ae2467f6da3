"""Imports have no side effects, and modules hold no state, except for what a process has only once."""

import ast
from pathlib import Path

SOURCE = Path(__file__).parent.parent / "src" / "splatreel"
EXCEPTIONS = {"base/jit.py", "base/threads.py"}
"""The choice of the kernel cache and the warmup; the number of threads, and the pool, which a forked process must replace."""
ROOT = SOURCE.parent.parent


def changes_globals(tree: ast.Module) -> bool:
    """Return whether a function assigns a variable of the module."""
    return any(isinstance(node, ast.Global) for node in ast.walk(tree))


def acts_on_import(tree: ast.Module) -> bool:
    """Return whether a module calls something for its effect when it is imported, also under an `if` or in a loop."""

    def acts(body: list[ast.stmt]) -> bool:
        for node in body:
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call | ast.Await):
                return True
            guarded = isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "__name__ == '__main__'")
            nested = [*getattr(node, "body", []), *getattr(node, "orelse", [])]
            if isinstance(node, ast.If | ast.For | ast.While | ast.With | ast.Try) and not guarded and acts(nested):
                return True
        return False

    return acts(tree.body)


def test_only_two_modules_hold_state_of_the_process() -> None:
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCE.rglob("*.py")}
    found = {
        path.relative_to(SOURCE).as_posix()
        for path, tree in trees.items()
        if changes_globals(tree) or acts_on_import(tree)
    }
    assert found == EXCEPTIONS


def test_the_guide_names_the_exceptions() -> None:
    guide = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rule = guide.partition("no global state")[2].partition("\n- ")[0]
    assert all(f"`{name}`" in rule for name in EXCEPTIONS)


def test_state_and_effects_are_found() -> None:
    assert changes_globals(ast.parse("def use(n):\n    global limit\n    limit = n"))
    assert acts_on_import(ast.parse("import os\nif hasattr(os, 'fork'):\n    os.register_at_fork()"))
    assert not acts_on_import(ast.parse("if __name__ == '__main__':\n    main()\nx = f()\n"))
