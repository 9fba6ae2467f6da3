"""The rules of the house for the npm packages: the import ladder of packages and rooms, and no import in a circle."""

import json
import re
from pathlib import Path
from typing import Any

from tests.test_house import sorter_of

ROOT = Path(__file__).parent.parent
PLAYER = ROOT / "player"
PACKAGES = {folder.parent.name: folder for folder in sorted((PLAYER / "packages").glob("*/src"))}
"""Sources of the packages."""
LADDER = (("decoder",), ("renderer",), ("element", "three", "playcanvas"))
"""The packages, from the lowest rung up."""
ROOMS = {
    "decoder": (
        ("base",),
        ("files",),
        ("reel",),
        ("decode",),
        ("stream",),
        ("reader",),
        ("thread-worker.ts",),
        ("index.ts", "internal.ts", "node.ts", "node-worker.ts"),
    ),
    "renderer": (("base", "files"), ("sound",), ("draw",), ("webgl",), ("playback",), ("index.ts",)),
    "element": (
        ("base", "files"),
        ("camera",),
        ("player", "languages"),
        ("ui",),
        ("element",),
        ("main.ts", "self-test"),
    ),
}
"""Folders and files of a package, from the lowest rung up; those of one rung do not import each other. The files of a package without
folders import each other in no circle."""


def manifest_of(package: str) -> dict[str, Any]:
    """Return the package.json of a package."""
    return json.loads((PLAYER / "packages" / package / "package.json").read_text(encoding="utf-8"))


def entry_points() -> dict[str, str]:
    """Return the sources of the declared entry points, by the names under which packages import them."""
    settings = json.loads((PLAYER / "tsconfig.json").read_text(encoding="utf-8"))["compilerOptions"]
    return {
        name: Path(source).relative_to("packages").as_posix().replace("/src/", "/")
        for name, (source,) in settings["paths"].items()
    }


def typescript_imports(source: str) -> list[str]:
    """Return what a TypeScript file imports of these packages, types and dynamic imports included."""
    return re.findall(r"""(?:\bfrom|\bimport)\s*\(?\s*["']((?:\.{1,2}/|@splatreel/)[^"']+)["']""", source)


def imports_of_typescript() -> dict[str, set[str]]:
    """Return the imports among the files of all packages, by names such as `renderer/draw/stage.ts`."""
    names = {
        path: f"{name}/{path.relative_to(root).as_posix()}"
        for name, root in PACKAGES.items()
        for path in root.rglob("*.ts")
    }
    entries, found = entry_points(), {}
    for path, name in names.items():
        targets = typescript_imports(path.read_text(encoding="utf-8"))
        files = [entries.get(target) or names.get((path.parent / f"{target}.ts").resolve()) for target in targets]
        found[name] = {file for file in files if file}
    return found


def test_typescript_imports_are_found() -> None:
    source = (
        'import type { A } from "./a";\nimport { b } from "uqr";\nimport "./c";\nexport type { D } from "../d/d";\n'
        'const e = await loadPart<typeof import("../e")>("e.js");\nimport { f } from "@splatreel/decoder";\n'
    )
    assert typescript_imports(source) == ["./a", "./c", "../d/d", "../e", "@splatreel/decoder"]
    imports = imports_of_typescript()["renderer/playback/session.ts"]
    assert {"renderer/draw/stage.ts", "decoder/internal.ts"} <= imports


def test_packages_import_only_declared_entry_points() -> None:
    declared = {
        f"{manifest['name']}{entry.removeprefix('.')}": package
        for package, manifest in ((package, manifest_of(package)) for package in PACKAGES)
        for entry in manifest["exports"]
    }
    assert set(entry_points()) <= set(declared), "an entry point of tsconfig.json is in no package.json"
    for package, root in PACKAGES.items():
        for path in root.rglob("*.ts"):
            for target in typescript_imports(path.read_text(encoding="utf-8")):
                if target.startswith("@"):
                    assert target in entry_points(), f"{path} imports {target}, which is no declared entry point"
                    assert declared[target] != package, f"{path} imports its own package"
                else:
                    assert (path.parent / target).resolve().is_relative_to(root.parent) or target.endswith(
                        "package.json"
                    ), f"{path} imports {target} of another package"


def test_packages_and_their_rooms_import_only_down() -> None:
    rungs = {package: rung for rung, packages in enumerate(LADDER) for package in packages}
    assert set(rungs) == set(PACKAGES), "each has a rung"
    rooms = {
        f"{package}/{name}": rung
        for package, ladder in ROOMS.items()
        for rung, names in enumerate(ladder)
        for name in names
    }
    found = imports_of_typescript()
    package = {file: file.split("/")[0] for file in found}
    room = {file: "/".join(file.split("/")[:2]) for file in found}
    folders = {name for file, name in room.items() if package[file] in ROOMS and not name.endswith(".d.ts")}
    assert folders == set(rooms), "each room has a rung"
    up = [
        f"{a} imports {b}"
        for a, others in found.items()
        for b in others
        if (package[a] != package[b] and rungs[package[b]] >= rungs[package[a]])
        or (
            package[a] == package[b]
            and room[a] != room[b]
            and rooms
            and rooms.get(room[b], -1) >= rooms.get(room[a], 0)
        )
    ]
    assert not up


def test_no_import_within_the_packages_goes_in_a_circle() -> None:
    assert sorter_of(imports_of_typescript())
