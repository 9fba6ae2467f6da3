"""Mutated reels, with which both readers are compared: each is one of the conformance cases with one false value or file.

`mutations()` returns them by name. `Mutation.write` writes the folder of one. The list is the same in every run.
"""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from conformance.run import HERE

from tests.fuzz.edits import Draft

JUNK: list[Any] = [None, True, -1, 0, 1, 7, 0.5, 1e300, 1 << 53, "", "x", [], {}]
"""Values that replace each value of a manifest."""
STRINGS: dict[str, list[Any]] = {
    "uri": [
        "../x",
        "/etc/passwd",
        "https://other.example/x",
        "groups/.hidden",
        "a//b",
        "x\n",
        "é",
        "a" * 501,
        "\ud800",
    ],
    "sha256": ["0" * 64, "0" * 63, "F" * 64, "g" * 64, "0" * 65, "0" * 64 + "\n"],
    "name": ["\ud800", "n" * 201, "High", "low"],
    "title": ["t" * 200, "t" * 201, "\U0001f600" * 200, "\ud800"],
    "description": ["d" * 2000, "d" * 2001],
    "type": ["text/html", 'audio/mp4; codecs="' + "a" * 100 + '"'],
}
"""Further values, by the name of the field."""
PRESENTED = {
    "title": "A room",
    "description": "",
    "poster": {"uri": "poster.jpg", "bytes": 9, "sha256": "0" * 64, "width": 16, "height": 9},
    "thumbnails": {
        "width": 16, "height": 9, "columns": 2, "rows": 2, "seconds": 1.0, "count": 5,
        "sheets": [{"uri": f"t/{i}.jpg", "bytes": 9, "sha256": "0" * 64} for i in range(2)],
    },
    "sound": {
        "type": 'audio/mp4; codecs="opus"', "rate": 48000, "channels": 2, "position": [0.0, 0.0, 1.0],
        "init": {"uri": "s/i.mp4", "bytes": 9, "sha256": "0" * 64},
        "segments": [{"uri": f"s/{i}.m4s", "bytes": 9, "sha256": "0" * 64, "start": 2.0 * i, "seconds": 2.0} for i in (0, 1)],
    },
    "limits": {"focus": [0.0, 0.0, 0.0], "angle": 30.0, "distance": [1.0, 8.0], "floor": -1.0},
    "clearance": {"focus": [0.0, 0.0, 0.0], "share": 0.3},
    "background": [0.0, 0.5, 1.0], "transparent": False, "origin": [0.0, 0.0, 0.0], "near": 0.01, "unknown": {"x": [1]},
}  # fmt: skip
"""Optional fields that no case has."""


@dataclass
class Reel:
    """Files of a reel and its manifest, which `seal` makes consistent."""

    manifest: dict[str, Any]
    files: dict[str, bytes]

    @property
    def entries(self) -> Iterator[dict[str, Any]]:
        """Entries of all files in the manifest."""
        yield from self.manifest["layers"]
        for group in self.manifest["groups"]:
            yield group
            yield from group.get("renditions", {}).values()
        yield from self.manifest.get("pages", [])

    def put(self, entry: dict[str, Any], data: bytes) -> None:
        """Replace the file of an entry, and its length and digest in the manifest."""
        self.files[entry["uri"]] = data
        entry |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
        self.seal()

    def seal(self) -> None:
        """Update the bytes of the renditions."""
        for rendition in self.manifest.get("renditions", []):
            groups = self.manifest["groups"]
            rendition["bytes"] = sum(g["renditions"].get(rendition["name"], g)["bytes"] for g in groups)


@dataclass
class Mutation:
    """A mutated reel: a case, and a function that changes it in place."""

    case: str
    change: Callable[[Reel], object]
    text: Callable[[str], bytes] = field(default=lambda text: text.encode("utf-8", "surrogatepass"))

    def write(self, folder: Path) -> None:
        """Write the reel."""
        reel = copy.deepcopy(load(self.case))
        self.change(reel)
        text = json.dumps(reel.manifest)
        for name, data in (reel.files | {"manifest.json": self.text(text)}).items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)


@cache
def load(case: str) -> Reel:
    """Return a case."""
    folder = HERE / case
    skipped = {"manifest.json", "expected.json"}
    files = {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in skipped
    }
    return Reel(json.loads((folder / "manifest.json").read_text(encoding="utf-8")), files)


def mutations() -> dict[str, Mutation]:
    """Return all mutated reels by name."""
    every = [*_values(), *_lists(), *_files(), *_headers(), *_texts(), *_pages()]
    assert len({name for name, _ in every}) == len(every)
    return dict(every)


def _place(value: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        value = value[key]
    return value


def _paths(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all values, of lists only those of the first and last item."""
    found = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else []
    for key, item in found:
        if isinstance(value, list) and 0 < key < len(value) - 1:
            continue
        yield (*path, key)
        yield from _paths(item, (*path, key))


def _edit(path: tuple[Any, ...], act: Callable[[Any, Any], object], extras: bool) -> Callable[[Reel], object]:
    def change(reel: Reel) -> None:
        reel.manifest |= copy.deepcopy(PRESENTED) if extras else {}
        act(_place(reel.manifest, path[:-1]), path[-1])

    return change


def _put(value: Any) -> Callable[[Any, Any], object]:
    return lambda holder, key: holder.__setitem__(key, value)


def _remove(holder: Any, key: Any) -> None:
    del holder[key]


def _add(amount: float) -> Callable[[Any, Any], object]:
    return lambda holder, key: holder.__setitem__(key, holder[key] + amount)


def _values() -> Iterator[tuple[str, Mutation]]:
    """Yield reels with one value of the manifest removed or replaced: some of JUNK at each place, and neighbors of numbers."""
    turn = 0
    for case, extras in (("layers", True), ("renditions", False), ("retired", False), ("pages", False)):
        manifest = load(case).manifest | (PRESENTED if extras else {})
        for path in _paths(manifest):
            name, old = f"{case}-{'.'.join(map(str, path))}", _place(manifest, path)
            junk = [JUNK[(turn + 4 * i) % len(JUNK)] for i in range(2)] + STRINGS.get(str(path[-1]), [])
            turn += 1
            if case != "layers" and turn % 2:
                continue
            if isinstance(path[-1], str) or not isinstance(old, int | float):
                yield f"{name}-removed", Mutation(case, _edit(path, _remove, extras))
            for number, value in enumerate(junk if case == "layers" else junk[:1]):
                what = f"{number}={json.dumps(value)[:12]}"
                if not (isinstance(old, int | float) and isinstance(path[-1], int) and value in (0, 1)):
                    yield f"{name}-{what}", Mutation(case, _edit(path, _put(value), extras))
            if type(old) is int:
                for amount in (-1, 1, 0.0) if case == "layers" else (1,):
                    yield f"{name}{amount:+}", Mutation(case, _edit(path, _add(amount), extras))


def _swap(items: list[Any], *names: str) -> None:
    """Exchange fields of the first two items; without names, the items."""
    if not names:
        items[0], items[1] = items[1], items[0]
    for name in names:
        items[0][name], items[1][name] = items[1][name], items[0][name]


CONTENT = ("uri", "bytes", "sha256")


def _lists() -> Iterator[tuple[str, Mutation]]:
    """Yield reels whose lists name other files: one file twice, and files that are missing, swapped or of another place."""
    for case in ("layers", "parts", "retired", "renditions", "static", "dynamic", "overlaps"):
        for kind in ("groups", "layers"):
            entries = load(case).manifest[kind]
            pairs: dict[str, Callable[[list[Any]], object]] = {
                "swapped": _swap,
                "one-twice": lambda e: e.insert(1, copy.deepcopy(e[0])),
                "first-missing": lambda e: e.pop(0),
                "last-missing": lambda e: e.pop(),
                "one-file": lambda e: e[1].update({n: e[0][n] for n in CONTENT}),
                "one-uri": lambda e: e[1].update(uri=e[0]["uri"]),
                "one-file-and-points": lambda e: e[1].update({n: e[0][n] for n in (*CONTENT, "points")}),
                "files-swapped": lambda e: _swap(e, *CONTENT),
                "files-and-points-swapped": lambda e: _swap(e, *CONTENT, "points"),
                "digests-swapped": lambda e: _swap(e, "sha256"),
                "times-swapped": lambda e: _swap(e, "first_frame"),
            }
            for name, change in pairs.items():
                if len(entries) > 1 or (entries and name in ("one-twice", "first-missing", "last-missing")):
                    yield (
                        f"{case}-{kind}-{name}",
                        Mutation(case, lambda r, k=kind, c=change: (c(r.manifest[k]), r.seal())),
                    )
    for kind, other in (("groups", "layers"), ("layers", "groups")):
        change = lambda r, k=kind, o=other: r.manifest[k][0].update({n: r.manifest[o][0][n] for n in CONTENT})  # noqa: E731
        yield f"{kind}-of-{other}", Mutation("layers", change)


def _foreign(reel: Reel, kind: str, at: int, case: str, name: str) -> None:
    reel.put(reel.manifest[kind][at], load(case).files[name])


def _files() -> Iterator[tuple[str, Mutation]]:
    """Yield reels of which one file is another than the manifest says, or of another reel."""
    for case in ("layers", "renditions", "pages"):
        entries = list(load(case).entries)
        for index in (0, len(entries) // 2, len(entries) - 1):
            acts: dict[str, Callable[[Reel, str], object]] = {
                "missing": lambda r, uri: r.files.pop(uri),
                "empty": lambda r, uri: r.files.update({uri: b""}),
                "shorter": lambda r, uri: r.files.update({uri: r.files[uri][:-1]}),
                "longer": lambda r, uri: r.files.update({uri: r.files[uri] + b"\0"}),
                "one-bit": lambda r, uri: r.files.update({uri: r.files[uri][:-1] + bytes([r.files[uri][-1] ^ 1])}),
            }
            for name, act in acts.items():
                yield f"{case}-file-{index}-{name}", Mutation(case, lambda r, a=act, u=entries[index]["uri"]: a(r, u))
    for case in ("predictive", "layers", "light", "shade", "sh-3", "static"):
        for kind, at, name in (("groups", 0, "groups/0000.safetensors"), ("layers", 0, "layers/0000.safetensors")):
            change = lambda r, k=kind, a=at, c=case, n=name: _foreign(r, k, a, c, n)  # noqa: E731
            yield f"cross-fade-{kind}-of-{case}", Mutation("cross-fade", change)


def _rewritten(reel: Reel, kind: str, at: int, change: Callable[[Draft], object]) -> None:
    entry = reel.manifest[kind][at]
    draft = Draft.of(reel.files[entry["uri"]])
    change(draft)
    reel.put(entry, draft.pack())


def _headers() -> Iterator[tuple[str, Mutation]]:
    """Yield reels of which one file contradicts its entry or itself. Lengths and digests are those of the changed file."""
    turn = 0
    for case, kinds in (
        ("layers", ("layers",)),
        ("shade", ("groups",)),
        ("light", ("groups",)),
        ("paper", ("layers", "groups")),
    ):
        for kind in kinds:
            uri = load(case).manifest[kind][0]["uri"]
            draft = Draft.of(load(case).files[uri])
            changes: dict[str, Callable[[Draft], object]] = {"no-metadata": lambda d: d.own.clear()}
            for name in ("index", "points", "first_frame", "frames", "version", "kind"):
                for value in ("group", "layer", None) if name == "kind" else (None, -1, 0, 1, 5, 0.5, 1 << 41):
                    changes[f"{name}-{value}"] = lambda d, n=name, v=value: d.own.update({n: v})
            for section, parameters in draft.own["sections"].items():
                changes[f"{section}-removed"] = lambda d, s=section: d.own["sections"].pop(s)
                changes[f"{section}-no-data"] = lambda d, s=section: d.sections.pop(s)
                changes[f"{section}-cut"] = lambda d, s=section: d.sections.update({s: d.sections[s][:-1]})
                changes[f"{section}-longer"] = lambda d, s=section: d.sections.update({s: d.sections[s] + b"\0"})
                changes[f"{section}-zeros"] = lambda d, s=section: d.sections.update({s: bytes(len(d.sections[s]))})
                changes[f"{section}-no-bytes"] = lambda d, s=section: d.places.update({s: {"dtype": "I8"}})
                changes[f"{section}-shape"] = lambda d, s=section: d.places.update(
                    {s: {"shape": [1, len(d.sections[s])]}}
                )
                for name in parameters:
                    turn += 3
                    for value in ([None, -1, 0, 3, 0.5, "x", True] * 2)[turn % 7 :][:2]:
                        changes[f"{section}-{name}-{value}"] = lambda d, s=section, n=name, v=value: d.own["sections"][
                            s
                        ].update({n: v})
            changes["unknown-section"] = lambda d: d.sections.update(unknown=b"1234")
            changes["unknown-parameters"] = lambda d: (d.sections.update(u=b"12"), d.own["sections"].update(u={"a": 1}))
            changes["unknown-tensor"] = lambda d: (
                d.sections.update(u=b"12"),
                d.places.update(u={"dtype": "I8", "shape": 3}),
            )
            for name, change in changes.items():
                yield (
                    f"{case}-{kind}-header-{name}",
                    Mutation(case, lambda r, k=kind, c=change: _rewritten(r, k, 0, c)),
                )


def _texts() -> Iterator[tuple[str, Mutation]]:
    """Yield reels whose manifest is no JSON of UTF-8, or unusual JSON."""
    texts: dict[str, Callable[[str], bytes]] = {
        "empty": lambda t: b"",
        "cut": lambda t: t[:-1].encode(),
        "twice": lambda t: (t + t).encode(),
        "list": lambda t: f"[{t}]".encode(),
        "latin-1": lambda t: t.replace("{", '{"t": "\xe9",', 1).encode("latin-1"),
        "utf-16": lambda t: t.encode("utf-16"),
        "byte-order-mark": lambda t: t.encode("utf-8-sig"),
        "spaces": lambda t: b" \t\r\n" + t.encode() + b"\n\n",
        "other-space": lambda t: "\xa0".encode() + t.encode(),
        "nan": lambda t: t.replace("{", '{"t": NaN,', 1).encode(),
        "infinity": lambda t: t.replace("{", '{"t": -Infinity,', 1).encode(),
        "overflow": lambda t: t.replace("{", '{"t": 1e999,', 1).encode(),
        "long-integer": lambda t: t.replace("{", '{"t": ' + "9" * 5000 + ",", 1).encode(),
        "key-twice": lambda t: t.replace("{", '{"live": 7,', 1).encode(),
        "half-a-character": lambda t: t.replace("{", '{"t": "\\ud800",', 1).encode(),
        "half-a-character-in-a-key": lambda t: t.replace("{", '{"\\ud800": 1,', 1).encode(),
        "whole-character": lambda t: t.replace("{", '{"t": "\\ud83d\\ude00",', 1).encode(),
        "escaped-backslash": lambda t: t.replace("{", '{"t": "\\\\ud800",', 1).encode(),
        "deep": lambda t: t.replace("{", '{"t": ' + "[" * 63 + "]" * 63 + ",", 1).encode(),
        "too-deep": lambda t: t.replace("{", '{"t": ' + "[" * 64 + "]" * 64 + ",", 1).encode(),
        "control-character": lambda t: t.replace("{", '{"t": "\x01",', 1).encode(),
        "comma": lambda t: t.replace("{", '{"t": [1,],', 1).encode(),
        "zero": lambda t: t.replace("{", '{"t": 01,', 1).encode(),
    }
    for name, text in texts.items():
        yield f"text-{name}", Mutation("dynamic", lambda r: None, text)


def _paged(reel: Reel, at: int, change: Callable[[dict[str, Any]], object]) -> None:
    entry = reel.manifest["pages"][at]
    page = json.loads(reel.files[entry["uri"]])
    change(page)
    reel.put(entry, json.dumps(page).encode())


def _pages() -> Iterator[tuple[str, Mutation]]:
    """Yield reels with a changed page, whose length and digest are right."""
    pages: dict[str, Callable[[dict[str, Any]], object]] = {
        "no-layers": lambda p: p.pop("layers"),
        "no-groups": lambda p: p.update(groups=[]),
        "layer-missing": lambda p: p["layers"].pop(),
        "layer-twice": lambda p: p["layers"].append(p["layers"][-1]),
        "layers-swapped": lambda p: _swap(p["layers"]),
        "layer-permanent": lambda p: p["layers"][-1].pop("until"),
        "group-missing": lambda p: p["groups"].pop(),
        "group-twice": lambda p: p["groups"].append(p["groups"][-1]),
        "groups-swapped": lambda p: _swap(p["groups"]),
        "group-files-swapped": lambda p: _swap(p["groups"], *CONTENT),
        "first-frame": lambda p: p["groups"][0].update(first_frame=p["groups"][0]["first_frame"] + 1),
        "second-frame": lambda p: p["groups"][1].update(first_frame=p["groups"][1]["first_frame"] + 1),
        "frames": lambda p: p["groups"][0].update(frames=1),
        "digest": lambda p: p["groups"][0].update(sha256="0" * 64),
        "no-digest": lambda p: p["groups"][0].pop("sha256"),
        "until": lambda p: p["layers"][-1].update(until=p["layers"][-1]["until"] + 1),
        "until-later": lambda p: p["layers"][-1].update(until=1 << 40),
        "born-earlier": lambda p: p["layers"][-1].update(group=max(p["layers"][-1]["group"] - 1, 0)),
        "points": lambda p: p["layers"][0].update(points=p["layers"][0]["points"] + 1),
        "unknown": lambda p: p.update(unknown=1),
        "half-a-character": lambda p: p.update(unknown="\ud800"),
    }
    for at in (0, 1):
        for name, change in pages.items():
            yield f"page-{at}-{name}", Mutation("pages", lambda r, a=at, c=change: _paged(r, a, c))
    yield "pages-swapped", Mutation("pages", lambda r: _swap(r.manifest["pages"]))
    yield "pages-files-swapped", Mutation("pages", lambda r: _swap(r.manifest["pages"], *CONTENT))
    yield "pages-one-file", Mutation("pages", lambda r: r.manifest["pages"][1].update(r.manifest["pages"][0]))
    yield "pages-first-missing", Mutation("pages", lambda r: r.manifest["pages"].pop(0))
    yield "pages-last-missing", Mutation("pages", lambda r: r.manifest["pages"].pop())
