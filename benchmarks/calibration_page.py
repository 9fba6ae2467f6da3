"""Write the table of docs/calibration.md from the latest records of `calibration.py`.

python benchmarks/calibration_page.py
"""

import json
from functools import partial
from pathlib import Path

from document import replaced_between
from record import RESULTS, ROOT

PAGE = ROOT / "docs" / "calibration.md"
BEGIN, END = "<!-- results: written by benchmarks/calibration_page.py -->", "<!-- end of results -->"
replaced = partial(replaced_between, BEGIN, END)
"""Function from a document and a text to the document with the text between its markers."""
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
WAYS = {"": "by default", "match": "with `[match]`", "same lens": "`--same-lens`"}
COLUMNS = ("capture", "cameras", "degrees to the nearest", *WAYS.values())

Records = dict[tuple[str, int], dict[str, dict]]
"""Latest records by capture and number of cameras, and by the way of the calibration."""


def latest(results: Path = RESULTS) -> Records:
    """Return the last record of each case and way."""
    found: Records = {}
    for line in results.read_text(encoding="utf-8").splitlines() if results.exists() else []:
        value = json.loads(line)
        word, _, name = value["benchmark"].partition(" ")
        if word == "calibration" and "neighbor_degrees" in value:
            way = "same lens" if value.get("same_lens") else "match" if value["learned"] else ""
            found.setdefault((name, value["cameras"]), {})[way] = value
    return found


def table(records: Records) -> str:
    """Return the Markdown table."""
    lines = [_row(COLUMNS), _row(["---"] * len(COLUMNS))]
    for name, label in CAPTURES.items():
        for count in sorted({count for capture, count in records if capture == name}, reverse=True):
            lines.append(_row(_cells(label, count, records[name, count])))
    return "\n".join(lines)


def _cells(label: str, count: int, ways: dict[str, dict]) -> list[str]:
    """Return the cells of a rig. Learned matches are not used for what is placed without them."""
    degrees = next(iter(ways.values()))["neighbor_degrees"]
    is_placed = "" in ways and ways[""]["placed"]
    known = {**ways, "match": ways[""]} if is_placed else ways
    return [label, str(count), f"{degrees:.0f}", *(_result(known.get(way)) for way in WAYS)]


def _result(record: dict | None) -> str:
    """Return the number of placed cameras and the medians of their errors."""
    if record is None:
        return ""
    if not record["placed"]:
        return "refused"
    turned, moved = (record[name]["median"] for name in ("rotation_degrees", "position_percent"))
    return f"{record['placed']} placed, {turned:.2f}°, {moved:.2f} %"


def _row(cells: list[str] | tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    PAGE.write_text(replaced(PAGE.read_text(encoding="utf-8"), table(latest())), encoding="utf-8")
    print(table(latest()))
