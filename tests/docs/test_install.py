"""Packages that each system gets, as docs/install.md says."""

import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parent.parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SYSTEMS = {
    "Linux, x86-64": ("linux", "x86_64", "6.8.0"),
    "Linux, ARM": ("linux", "aarch64", "6.8.0"),
    "macOS 14 or newer, Apple silicon": ("darwin", "arm64", "23.1.0"),
    "macOS 26": ("darwin", "arm64", "25.0.0"),
    "macOS 13, Apple silicon": ("darwin", "arm64", "22.6.0"),
    "macOS, Intel": ("darwin", "x86_64", "23.1.0"),
    "Windows, x86-64": ("win32", "AMD64", "11"),
    "Windows, ARM": ("win32", "ARM64", "11"),
}


def packages(system: str, texts: list[str]) -> set[str]:
    platform, machine, release = SYSTEMS[system]
    environment = {"sys_platform": platform, "platform_machine": machine, "platform_release": release}
    found = map(Requirement, texts)
    return {each.name for each in found if each.marker is None or each.marker.evaluate(environment)}


@pytest.mark.parametrize("system", SYSTEMS)
def test_packages_without_a_wheel_are_left_out(system: str) -> None:
    base, recon = (
        packages(system, texts) for texts in (PROJECT["dependencies"], PROJECT["optional-dependencies"]["recon"])
    )
    assert {"numpy", "numba", "av", "starlette"} <= base
    assert {"opencv-python-headless", "wgpu"} <= recon
    assert ("DracoPy" in base) == (system != "Windows, ARM")
    complete = {"Linux, x86-64", "macOS 14 or newer, Apple silicon", "macOS 26", "Windows, x86-64"}
    assert ("pycolmap" in recon) == (system in complete)


def test_every_system_has_a_row() -> None:
    text = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
    assert [system for system in SYSTEMS if system != "macOS 26" and f"| {system}" not in text] == []
