import re
import shlex
from pathlib import Path

import pytest
from PIL import Image

from splatreel.cli.main import build

ROOT = Path(__file__).parent.parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_first_image_moves_and_leads_to_the_sample_on_the_site() -> None:
    """The site's hook puts the player with the sample at this address (tests/docs/test_site.py)."""
    found = re.search(r"\[!\[[^\]]+\]\(([^)]+)\)\]\(([^)]+)\)", README)
    assert found is not None
    (site,) = re.findall(r"^site_url: (\S+)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert found[2] == f"{site}sample/"
    assert (ROOT / found[1]).stat().st_size < 1_500_000
    with Image.open(ROOT / found[1]) as image:
        assert getattr(image, "n_frames", 1) > 20
    assert README.index("    make demo") < README.index("\n## ")


def test_the_python_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    example = re.search(r"```python\n(.*?)```", README, re.DOTALL)
    assert example is not None
    code = example[1].replace("out/demo", str(ROOT / "tests" / "data" / "golden"))
    assert len(code.splitlines()) <= 6
    exec(compile(code, "README.md", "exec"), {})
    assert re.fullmatch(r"\d+ \(\d+, \d+, 3\)\n", capsys.readouterr().out)


def test_the_named_options_exist(capsys: pytest.CaptureFixture[str]) -> None:
    """Every `splatreel VERB --option` of the README is one that the verb's help knows."""
    lines = [line.split("#")[0].strip() for line in README.splitlines() if line.startswith("    splatreel ")]
    checked = 0
    for line in lines:
        options = [word for word in shlex.split(line) if word.startswith("--")]
        if options:
            verb = [word for word in line.split()[1:3] if word.isalpha() and word.islower()]
            with pytest.raises(SystemExit):
                build().cli(prog="splatreel", args=[*verb, "--help"])
            known = capsys.readouterr().out
            assert [option for option in options if option not in known] == []
            checked += len(options)
    assert checked >= 8
