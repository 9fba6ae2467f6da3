"""The documentation site, without building it: its navigation and its reference name what exists."""

import importlib
import importlib.util
import re
import shutil
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from splatreel.cli.main import build
from splatreel.config.settings import sections, settings

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs"
REFERENCE = sorted((DOCS / "reference").glob("*.md"))


def navigation() -> list[str]:
    """Return the files that mkdocs.yml puts into the navigation."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    return re.findall(r": ([\w./-]+\.md)$", text.partition("\nnav:")[2].partition("\n\n")[0], re.MULTILINE)


def resolve(identifier: str) -> Any:
    """Return the module, class or function of a dotted name."""
    parts = identifier.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for name in parts[cut:]:
            found = getattr(found, name)
        return found
    raise ModuleNotFoundError(identifier)


def test_navigation_has_every_page() -> None:
    pages = {path.relative_to(DOCS).as_posix() for path in (*DOCS.glob("*.md"), *REFERENCE)}
    assert set(navigation()) == pages | {"experiments/README.md", "contributing.md"}


@pytest.mark.parametrize("page", REFERENCE, ids=lambda path: path.stem)
def test_reference_names_what_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"^::: (\S+)$", text, re.MULTILINE) + re.findall(r"\]\[(splatreel\.[\w.]+)\]", text)
    assert named
    for identifier in named:
        resolve(identifier)


def test_reference_has_every_public_name() -> None:
    import splatreel

    text = (DOCS / "reference" / "index.md").read_text(encoding="utf-8")
    assert [name for name in splatreel.__all__ if f"[`{name}`][" not in text] == []


def test_site_is_of_the_repository() -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (address,) = re.findall(r"^repo_url: (\S+)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert f'Repository = "{address}"' in project


@pytest.fixture
def hooks() -> ModuleType:
    spec = importlib.util.spec_from_file_location("site_hooks", DOCS / "hooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_links_of_the_guide_for_contributors_lead_to_pages_and_files(hooks: ModuleType) -> None:
    config = SimpleNamespace(repo_url="https://example.org")

    def on(page: str, text: str) -> str:
        shown = SimpleNamespace(file=SimpleNamespace(src_uri=page))
        return hooks.on_page_markdown(text, page=shown, config=config, files=None)

    assert on("contributing.md", "[a](docs/design.md#verbs)") == "[a](design.md#verbs)"
    assert on("contributing.md", "[a](SECURITY.md)") == "[a](https://example.org/blob/main/SECURITY.md)"
    assert on("contributing.md", "[a](#tests) [b](https://a.b/docs/c.md)") == "[a](#tests) [b](https://a.b/docs/c.md)"
    assert on("index.md", "[a](../CONTRIBUTING.md#tests)") == "[a](contributing.md#tests)"
    assert on("reference/index.md", "[a](../../CONTRIBUTING.md)") == "[a](../contributing.md)"
    assert on("reference/index.md", "[a](readers.md)") == "[a](readers.md)"


def first_page(hooks: ModuleType) -> str:
    page = SimpleNamespace(file=SimpleNamespace(src_uri="index.md"))
    config = SimpleNamespace(repo_url="https://example.org")
    return hooks.on_page_markdown((DOCS / "index.md").read_text(encoding="utf-8"), page=page, config=config, files=None)


def test_site_lists_every_setting_and_when_it_has_an_effect(hooks: ModuleType) -> None:
    page = SimpleNamespace(file=SimpleNamespace(src_uri="reference/config.md"))
    source = (DOCS / "reference" / "config.md").read_text(encoding="utf-8")
    config = SimpleNamespace(repo_url="https://example.org")
    lines = hooks.on_page_markdown(source, page=page, config=config, files=None).splitlines()
    listed = [line.split("`")[1] for line in lines if line.startswith("| `")]
    assert listed == sorted(settings(), key=lambda name: [*sections()].index(settings()[name].section))
    (crf,) = [line for line in lines if line.startswith("| `encode.h265.crf` | 20 |")]
    assert crf.endswith(
        "Has an effect only with `encode.codec=h265`. Has an effect only with `encode.h265.source=ofs or ori or dif`. |"
    )


def test_first_page_plays_the_sample_with_the_player_of_the_package(
    hooks: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sample = shutil.copytree(ROOT / "tests" / "data" / "golden-predictive", tmp_path / "sample")
    monkeypatch.setattr(hooks, "SAMPLE", sample)
    text, site = first_page(hooks), tmp_path / "site"
    assert hooks.finish_site(site) == []
    assert "images/reel.webp" not in text
    assert "autoplay" in text
    for address in re.findall(r'src="([^"]+)"', text):
        assert (site / address).is_file(), address
    assert (site / "sample" / "reel" / "groups" / "0000.safetensors").is_file()
    assert (site / "sample" / "decode-worker.js").is_file()
    assert (site / "sample" / "index.html").is_file()  # opens reel/manifest.json beside it


def test_player_replaces_no_page(hooks: ModuleType, tmp_path: Path) -> None:
    assert f"{hooks.LIVE}.md" not in navigation()
    page = tmp_path / hooks.LIVE / "index.html"
    page.parent.mkdir()
    page.write_text("<p>A page.</p>", encoding="utf-8")
    assert len(hooks.finish_site(tmp_path)) == 1
    assert page.read_text(encoding="utf-8") == "<p>A page.</p>"


def test_broken_links_of_a_finished_site_are_found(hooks: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    good = '<h1 id="top">A</h1><a href="sub/#part">b</a><a href="https://a.b/c">c</a><a href="/base/sub/">d</a>'
    bad = '<a href="none/">a</a><a href="sub/#none">b</a><img src="none.png"><a href="/base/none">c</a><a href="#none">d</a>'
    (tmp_path / "index.html").write_text(good, encoding="utf-8")
    (tmp_path / "sub" / "index.html").write_text('<p id="part"><a href="../#top">e</a></p>', encoding="utf-8")
    assert hooks.broken_links(tmp_path, "/base/") == []
    (tmp_path / "index.html").write_text(bad, encoding="utf-8")
    found = hooks.broken_links(tmp_path, "/base/")
    assert found[:5] == [f"index.html: {link}" for link in ("#none", "/base/none", "none.png", "none/", "sub/#none")]
    assert found[5:] == ["sub/index.html: ../#top"]


def test_pages_do_not_let_the_theme_ask_other_hosts(hooks: ModuleType) -> None:
    """The script of the theme asks api.github.com about the repository if this mark is there."""
    link = '<a href="https://github.com/a/b" title="Go to repository" class="md-source" data-md-component="source">'
    assert "data-md-component" not in hooks.on_post_page(link)
    assert "https://github.com/a/b" in hooks.on_post_page(link)


def test_first_page_of_a_checkout_without_the_sample_shows_the_image(
    hooks: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hooks, "SAMPLE", tmp_path / "none")
    assert hooks.finish_site(tmp_path / "site") == []
    assert "images/reel.webp" in first_page(hooks)
    assert not (tmp_path / "site").exists()


def test_names_break_in_tables_and_not_in_blocks_of_code(hooks: ModuleType) -> None:
    block = "<pre><span></span><code>.venv/bin/splatreel capture film room\n</code></pre>"
    assert hooks.on_page_content(block) == block
    inline = "<p>In <code>.venv/bin/pip</code>.</p>"
    assert hooks.on_page_content(inline) == inline
    cell = "<td><code>capture/readers/</code> and <code>run/store.py</code></td>"
    assert "<code>run/<wbr>store.py</code>" in hooks.on_page_content(cell)


def test_tutorial_uses_verbs_that_exist(capsys: pytest.CaptureFixture[str]) -> None:
    """Every command of the tutorial is a verb of `splatreel` with options that its help knows."""
    text = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    assert "python -c" not in text
    commands = re.findall(r"\.venv/bin/splatreel ([^\n`]+)", text)
    assert len(commands) >= 7
    helps: dict[str, str] = {}
    for command in commands:
        words = command.split()
        verb = words[: 2 if words[0] == "capture" else 1]
        if " ".join(verb) not in helps:
            with pytest.raises(SystemExit):
                build().cli(prog="splatreel", args=[*verb, "--help"])
            helps[" ".join(verb)] = capsys.readouterr().out
        assert [word for word in words if word.startswith("--") and word not in helps[" ".join(verb)]] == [], command
