"""A table as Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

from splatreel.evaluation.report import markdown_table

SPECIAL = {"&": r"\&", "%": r"\%", "#": r"\#", "_": r"\_", "^": r"\^{}", "↑": r"$\uparrow$", "↓": r"$\downarrow$"}
"""Characters that LaTeX writes differently."""


@dataclass(frozen=True)
class PaperTable:
    """A table in the paper's layout.

    Attributes:
        caption: Caption, with what differs from the paper.
        heads: Heads of the columns.
        rows: Cells of each row.
    """

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]

    def to_markdown(self) -> str:
        """Return caption and table as Markdown."""
        return "\n".join([self.caption, "", *markdown_table(self.heads, self.rows)]) + "\n"

    def to_csv(self) -> str:
        """Return the table as CSV, without its caption."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.heads, *self.rows])
        return text.getvalue()

    def to_latex(self) -> str:
        """Return the table as LaTeX with the rules of the package booktabs."""
        lines = [r"\begin{table}", rf"\caption{{{_latex(self.caption)}}}"]
        lines += [rf"\begin{{tabular}}{{l{'r' * (len(self.heads) - 1)}}}", r"\toprule", _row(self.heads), r"\midrule"]
        lines += [_row(row) for row in self.rows]
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}"]) + "\n"


def _row(cells: Sequence[str]) -> str:
    return f"{' & '.join(map(_latex, cells))} \\\\"


def _latex(text: str) -> str:
    return "".join(SPECIAL.get(letter, letter) for letter in text)
