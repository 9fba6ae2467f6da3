"""The rules of the house for the npm packages: the import ladder, the sizes of files, and a row in the documentation for each file."""

import re
from pathlib import Path

import pytest

from tests.test_house import MAX_FILE_LINES, sorter_of

ROOT = Path(__file__).parent.parent
PACKAGES = {
    "decoder": ROOT / "player" / "packages" / "decoder" / "src",
    "player": ROOT / "player" / "src",
    "three": ROOT / "player" / "packages" / "three" / "src",
    "playcanvas": ROOT / "player" / "packages" / "playcanvas" / "src",
}
NAMES = {"@splatreel/decoder": "decoder", "splatreel-player": "player"}
"""Sources of the npm packages. A package imports only from those before it."""
ROOMS_OF_PACKAGES = {
    "decoder": (
        ("base",),
        ("files",),
        ("reel",),
        ("decode",),
        ("stream",),
        ("reader",),
        ("thread-worker.ts",),
        ("index.ts", "node.ts", "node-worker.ts"),
    ),
    "player": (
        ("base",),
        ("files",),
        ("camera", "sound"),
        ("draw",),
        ("webgl",),
        ("player", "languages"),
        ("ui",),
        ("element",),
        ("main.ts", "self-test"),
    ),
    "three": (
        ("raw-gl.ts", "shaders.ts", "views.ts"),
        ("blend-target.ts",),
        ("three-renderer.ts",),
        ("splat-reel.ts",),
        ("index.ts",),
    ),
    "playcanvas": (
        ("shaders.ts", "file-textures.ts"),
        ("engine.ts",),
        ("file-splats.ts",),
        ("playcanvas-renderer.ts",),
        ("engine-sorter.ts",),
        ("splat-reel.ts",),
        ("index.ts",),
    ),
}
"""The rooms of each package, from the lowest rung up; those of one rung do not import each other."""


def typescript_imports(source: str) -> list[str]:
    """Return the local files that a TypeScript file imports, types and dynamic imports included."""
    return re.findall(
        r"""(?:\bfrom|\bimport)\s*\(?\s*["']((?:\.{1,2}|@splatreel/decoder|splatreel-player)/[^"']+)["']""", source
    )


def imports_of_typescript() -> dict[str, set[str]]:
    """Return the imports among the files of all packages, by names such as `player/draw/stage.ts`."""
    names = {
        path: f"{name}/{path.relative_to(root).as_posix()}"
        for name, root in PACKAGES.items()
        for path in root.rglob("*.ts")
    }
    found = {}
    for path, name in names.items():
        files = []
        for target in typescript_imports(path.read_text(encoding="utf-8")):
            package = next((name for name in NAMES if target.startswith(f"{name}/")), None)
            inside = target.removeprefix(f"{package}/")
            file = PACKAGES[NAMES[package]] / inside if package else (path.parent / target).resolve()
            files.append(file.with_name(file.name + ".ts"))
        found[name] = {names[file] for file in files if file in names}
    return found


def test_typescript_imports_are_found() -> None:
    source = (
        'import type { A } from "./a";\nimport { b } from "uqr";\nimport "./c";\nexport type { D } from "../d/d";\n'
        'const e = await loadPart<typeof import("../e")>("e.js");\nimport { f } from "@splatreel/decoder/f/g";\n'
    )
    assert typescript_imports(source) == ["./a", "./c", "../d/d", "../e", "@splatreel/decoder/f/g"]
    imports = imports_of_typescript()["player/player/session.ts"]
    assert {"player/draw/stage.ts", "decoder/stream/reel-loader.ts"} <= imports


def test_the_rooms_of_the_packages_import_only_down() -> None:
    rungs = {
        f"{package}/{name}": (list(PACKAGES).index(package), rung)
        for package, rooms in ROOMS_OF_PACKAGES.items()
        for rung, names in enumerate(rooms)
        for name in names
    }
    found = imports_of_typescript()
    room = {file: "/".join(file.split("/")[:2]) for file in found}
    assert {name for name in room.values() if not name.endswith(".d.ts")} == set(rungs), "each has a rung"
    up = [
        f"{a} imports {b}"
        for a, others in found.items()
        for b in others
        if room[a] != room[b] and rungs[room[b]] >= rungs[room[a]]
    ]
    assert not up


def test_no_import_within_the_packages_goes_in_a_circle() -> None:
    assert sorter_of(imports_of_typescript())


@pytest.mark.parametrize("package", PACKAGES)
def test_the_documentation_of_a_package_names_each_of_its_files(package: str) -> None:
    text = (ROOT / "docs" / f"{package}.md").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("|")]
    room, told = "", set()
    for row in rows:
        first, files, *_ = [cell.strip() for cell in row.strip("|").split("|")] + [""]
        room = first.strip("`") if first.startswith("`") and first.endswith("/`") else room if not first else ""
        told |= (
            {(room + name).replace(f"{room}../", "") for name in re.findall(r"`([\w./-]+)`", files)} if room else set()
        )
    names = [file.partition("/") for file in imports_of_typescript()]
    files = {file.removesuffix(".ts") for name, _, file in names if name == package and not file.endswith(".d.ts")}
    assert not files - told, f"in no row of docs/{package}.md"
    assert not {name for name in told - files if name != "wasm"}, "not in the package"


def test_files_fit() -> None:
    files = [path for root in PACKAGES.values() for path in root.rglob("*.ts")]
    assert not [path for path in files if len(path.read_text(encoding="utf-8").splitlines()) > MAX_FILE_LINES]
