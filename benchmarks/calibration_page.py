"""Write the table of docs/calibration.md from the latest records of `calibration.py`.

python benchmarks/calibration_page.py
"""

import json
from pathlib import Path

from record import RESULTS, ROOT

PAGE = ROOT / "docs" / "calibration.md"
BEGIN, END = "<!-- results: written by benchmarks/calibration_page.py -->", "<!-- end of results -->"
CAPTURES = {
    "built-in": "built-in, an arc of 50 degrees",
    "kitchen": "kitchen, a wall of cameras",
    "hearth": "hearth, a wall of cameras",
    "yard": "yard, an arc of 140 degrees",
    "studio": "studio, an arc of 190 degrees",
    "cove": "cove, a ring before white walls",
    "dominoes": "dominoes, a ring",
    "juggle": "juggle, a dome",
    "basketball": "Panoptic basketball, a dome",
}
COLUMNS = (
    "capture",
    "cameras",
    "degrees to the nearest",
    "placed",
    "rotation",
    "position",
    "with `match`: rotation",
    "position",
)
MISSING = "*not measured*"

Records = dict[tuple[str, int, bool], dict]
"""Latest records by capture, number of cameras, and whether learned matches were used."""


def latest(results: Path = RESULTS) -> Records:
    """Return the last record of each case."""
    found: Records = {}
    for line in results.read_text(encoding="utf-8").splitlines() if results.exists() else []:
        value = json.loads(line)
        word, _, name = value["benchmark"].partition(" ")
        if word == "calibration" and "neighbor_degrees" in value:
            found[name, value["cameras"], value["learned"]] = value
    return found


def table(records: Records) -> str:
    """Return the Markdown table."""
    lines = [_row(COLUMNS), _row(["---"] * len(COLUMNS))]
    for name, label in CAPTURES.items():
        counts = sorted({count for capture, count, _ in records if capture == name}, reverse=True)
        for count in counts:
            plain, learned = (records.get((name, count, with_match)) for with_match in (False, True))
            if plain is not None:
                lines.append(_row(_cells(label, count, plain, learned)))
    return "\n".join(lines)


def _cells(label: str, count: int, plain: dict, learned: dict | None) -> list[str]:
    cells = [label, str(count), f"{plain['neighbor_degrees']:.0f}"]
    if not plain["placed"]:
        return [*cells, "refused", "", "", "", ""]
    more = _errors(learned) if learned is not None and learned["placed"] else [MISSING, MISSING]
    return [*cells, str(plain["placed"]), *_errors(plain), *more]


def _errors(record: dict) -> list[str]:
    """Return the cells of rotation and position: median and maximum."""
    pairs = [(record["rotation_degrees"], "°"), (record["position_percent"], " %")]
    return [f"{error['median']:.2f}, {error['max']:.2f}{unit}" for error, unit in pairs]


def _row(cells: list[str] | tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"


def replaced(text: str, inner: str) -> str:
    """Return a document with the text between its two markers replaced.

    Raises:
        ValueError: A marker is missing.
    """
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"The document has no place for results: put {BEGIN} and {END} on lines of their own.")
    return f"{head}{begin}\n{inner}\n{end}{tail}"


if __name__ == "__main__":
    PAGE.write_text(replaced(PAGE.read_text(encoding="utf-8"), table(latest())), encoding="utf-8")
    print(table(latest()))
