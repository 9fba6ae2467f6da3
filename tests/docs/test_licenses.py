"""Every package that a tested installation has is pinned, and its license is told."""

import json
import re
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parent.parent.parent
PINS = dict(re.findall(r"^([A-Za-z0-9_.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.M))
LICENSES = (ROOT / "docs" / "licenses.md").read_text(encoding="utf-8").lower()


def plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def needed(name: str, extras: frozenset[str], seen: set[tuple[str, frozenset[str]]]) -> Iterator[str]:
    """Return all dependencies of an installed package, direct and indirect, without the package itself."""
    if (name, extras) in seen:
        return
    seen.add((name, extras))
    for text in metadata.requires(name) or []:
        requirement = Requirement(text)
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in extras or [""]):
            yield plain(requirement.name)
            yield from needed(requirement.name, frozenset(requirement.extras), seen)


def test_every_package_is_pinned_and_its_license_told() -> None:
    """The test covers the installed packages. Extras for models that users bring are not pinned."""
    found = set(needed("splatreel", frozenset({"", "recon", "dev"}), set())) - {"splatreel"}
    assert found - {plain(name) for name in PINS} == set()
    assert {name for name in found if name not in LICENSES.replace("_", "-")} == set()
    assert {"filelock", "markdown-it-py", "greenlet", "typeguard"} <= found


def test_what_the_player_is_made_of_is_told() -> None:
    package = json.loads((ROOT / "player" / "package.json").read_text(encoding="utf-8"))
    assert [name for name in package["devDependencies"] if name.lower() not in LICENSES] == []


def test_the_codecs_in_pyavs_wheel_are_told() -> None:
    folder = Path(str(metadata.distribution("av").locate_file("av.libs")))
    if not folder.is_dir():
        pytest.skip("PyAV comes from elsewhere than its wheel for Linux")
    parts = {re.sub(r"^lib|-[0-9a-f]{8}.*$", "", file.name).lower() for file in folder.iterdir()}
    told = {"svtav1enc": "svt-av1", "asound": "alsa", "mp3lame": "lame", "hogweed": "nettle (hogweed)", "vpx": "libvpx"}
    told |= dict.fromkeys(("opencore-amrnb", "opencore-amrwb"), "opencore amr") | {"sharpyuv": "libwebp"}
    found = {told.get(part, part.split("-")[0].removesuffix("mux")) for part in parts}
    ffmpeg = {part for part in found if part.startswith(("av", "sw"))}
    assert {part for part in found - ffmpeg if part not in LICENSES} == set()
