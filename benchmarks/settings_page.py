"""Write the tables of docs/defaults.md and docs/paper-map.md from the declarations of the settings.

python benchmarks/settings_page.py
"""

from collections.abc import Iterable
from functools import partial
from pathlib import Path

from document import replaced_between
from record import ROOT
from splatreel.config import Config, preset
from splatreel.config.setting_values import shown
from splatreel.config.settings import settings

DEFAULTS_PAGE, PAPER_MAP = ROOT / "docs" / "defaults.md", ROOT / "docs" / "paper-map.md"
BEGIN, END = "<!-- settings: written by benchmarks/settings_page.py -->", "<!-- end of settings -->"
replaced = partial(replaced_between, BEGIN, END)
"""Function from a document and a text to the document with the text between its markers."""
WITHOUT_QUALITY = ("encode.renditions", "region", "seed")
"""Settings that choose no quality, and are not in the table of defaults."""
STANDARD, PAPER = Config(), preset("paper")


def defaults_table() -> str:
    """Return the Markdown table of the defaults that measurements chose, and the lists of the other defaults."""
    lines = _head("setting", "default", "in `paper`", "chosen on", "seeds", "measured in")
    papers, others = [], []
    for setting in settings().values():
        default, paper = (shown(setting.of(config)) for config in (STANDARD, PAPER))
        if (chosen := setting.chosen) is not None:
            links = " ".join(f"[{number}]({address})" for number, address in enumerate(chosen.measured, 1))
            lines.append(_row(f"`{setting.name}`", default, paper, chosen.captures, chosen.seeds, links))
        elif setting.name not in WITHOUT_QUALITY:
            (papers if default == paper else others).append(f"`{setting.name}={default}`")
    lines += ["", f"**As in `paper`, not measured here:** {', '.join(papers)}."]
    lines += ["", f"**Chosen by time, by size or by hand, not measured:** {', '.join(others)}."]
    return "\n".join(lines)


def paper_table() -> str:
    """Return the Markdown table of the paper's hyper-parameters that are settings."""
    lines = _head("paper", "value", "setting", "in `standard`")
    for setting in settings().values():
        if setting.paper is not None:
            value = _joined(shown(setting.of(PAPER)), setting.paper.exceptions, "; ")
            standard = _joined(shown(setting.of(STANDARD)), setting.paper.standard, ": ")
            lines.append(_row(setting.paper.name, value, f"`{setting.name}`", standard))
    return "\n".join(lines)


def _joined(value: str, note: str, between: str) -> str:
    return f"{value}{between}{note}" if note else value


def _head(*columns: str) -> list[str]:
    return [_row(*columns), _row(*["---"] * len(columns))]


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def documents() -> Iterable[tuple[Path, str]]:
    """Yield each document and its text with the present tables."""
    for page, table in ((DEFAULTS_PAGE, defaults_table()), (PAPER_MAP, paper_table())):
        yield page, replaced(page.read_text(encoding="utf-8"), table)


if __name__ == "__main__":
    for document, text in documents():
        document.write_text(text, encoding="utf-8")
