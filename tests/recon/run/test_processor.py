import platform
import re
from pathlib import Path

import pytest

from splatreel.recon.run import processor
from splatreel.recon.run.processor import describe_processor, processor_name


@pytest.fixture(autouse=True)
def forgotten() -> None:
    processor_name.cache_clear()


def test_this_machine_has_a_name_and_cores() -> None:
    assert processor_name()
    assert re.fullmatch(rf"{re.escape(processor_name())}( with [A-Z]\S+)?, \d+ cores?", describe_processor())


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("processor\t: 0\nmodel name\t: AMD EPYC  7763 \nprocessor\t: 1\nmodel name\t: other\n", "AMD EPYC 7763"),
        ("processor\t: 0\nBogoMIPS\t: 108.00\n\nModel\t\t: Raspberry Pi 5\n", "Raspberry Pi 5"),
        ("processor : 0\nCPU part : 0xd40\n", "aarch64"),
        (None, "aarch64"),
    ],
)
def test_name_on_linux(text: str | None, name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(processor.sys, "platform", "linux")
    monkeypatch.setattr(platform, "processor", lambda: "")
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    monkeypatch.setattr(processor, "CPUINFO", tmp_path / "cpuinfo")
    if text is not None:
        processor.CPUINFO.write_text(text)
    assert processor_name() == name
    processor_name.cache_clear()


def test_processor_name_on_other_systems(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processor.sys, "platform", "darwin")
    answer = type("Answer", (), {"stdout": "Apple M2\n"})
    monkeypatch.setattr(processor.subprocess, "run", lambda *_, **__: answer)
    assert processor_name() == "Apple M2"
    processor_name.cache_clear()
