import csv
import io

from paper_tables.paper_table import PaperTable

TABLE = PaperTable("Table 6. 50% of x_y.", ["Methods", "PSNR ↑"], [["Full", "31.5"], ["w/o A & B, #1", "30"]])


def test_markdown_has_caption_and_cells() -> None:
    lines = TABLE.to_markdown().splitlines()
    assert lines[0] == "Table 6. 50% of x_y."
    assert lines[2:] == ["| Methods | PSNR ↑ |", "| --- | --- |", "| Full | 31.5 |", "| w/o A & B, #1 | 30 |"]


def test_csv_is_read_back() -> None:
    assert list(csv.reader(io.StringIO(TABLE.to_csv()))) == [list(TABLE.heads), *map(list, TABLE.rows)]


def test_latex_escapes_its_special_characters() -> None:
    text = TABLE.to_latex()
    assert r"\caption{Table 6. 50\% of x\_y.}" in text
    assert r"w/o A \& B, \#1 & 30 \\" in text
    assert r"PSNR $\uparrow$" in text
    assert r"\begin{tabular}{lr}" in text
