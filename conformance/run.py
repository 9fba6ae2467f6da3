"""Check a decoder against the conformance suite: python -m conformance.run [--arrays FOLDER] [CASE ...].

Without --arrays it checks the Python reader. Otherwise FOLDER holds CASE.npz of another decoder, with the arrays that
`CASE/expected.json` names. README.md describes the suite.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from tests.golden import decoded

from splatreel.base.errors import ReelError
from splatreel.codec.reader import ReelReader

HERE = Path(__file__).parent
COMPLETE, SAMPLES = 24, 12
"""An array of more than COMPLETE numbers is given by SAMPLES of them and two means."""


def cases() -> dict[str, str]:
    """Return what each case covers, by name."""
    return json.loads((HERE / "cases.json").read_text(encoding="utf-8"))


def expected(case: str) -> dict[str, Any]:
    """Return the expectations of a case."""
    return json.loads((HERE / case / "expected.json").read_text(encoding="utf-8"))


def refused() -> dict[str, dict[str, Any]]:
    """Return the reels that readers must refuse, by name (README.md)."""
    return json.loads((HERE / "refused.json").read_text(encoding="utf-8"))


def write_refused(name: str, folder: Path) -> None:
    """Write a reel that readers must refuse."""
    entry = refused()[name]
    shutil.copytree(HERE / entry["case"], folder)
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    for path, *value in entry["manifest"]:
        owner = manifest
        for key in path[:-1]:
            owner = owner[key]
        if value:
            owner[path[-1]] = value[0]
        else:
            del owner[path[-1]]
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    for uri, source in entry.get("files", {}).items():
        (folder / uri).unlink()
        if source:
            shutil.copy(HERE / source, folder / uri)


def refusal_of(folder: Path) -> str | None:
    """Return what the Python reader finds wrong with a reel; None for nothing. Decodes all groups and layers, in all renditions."""
    try:
        for rendition in ReelReader(folder).manifest.renditions or (None,):
            reel = ReelReader(folder, rendition)
            for entry in reel.manifest.groups:
                reel.static(entry.group)
                reel.group(entry.group)
    except ReelError as error:
        return str(error)
    return None


def arrays_of(folder: Path, times: list[float], renditions: list[str]) -> dict[str, np.ndarray]:
    """Return the arrays that the Python reader decodes. Those of a rendition begin with its name."""
    if not renditions:
        return decoded(folder, tuple(times))
    return {
        f"{name}:{array}": values
        for name in renditions
        for array, values in decoded(folder, tuple(times), name).items()
    }


def describe(array: np.ndarray) -> dict[str, Any]:
    """Return the entry of an array in expected.json, without the tolerance of decoders for display."""
    flat, entry = array.ravel(), {"shape": list(array.shape)}
    if array.dtype == bool:
        return entry | {"crc32": zlib.crc32(flat.astype(np.uint8).tobytes())}
    if flat.size <= COMPLETE:
        return entry | {"values": rounded(flat)}
    index = np.unique(np.linspace(0, flat.size - 1, SAMPLES).round().astype(int))
    return entry | {"index": index.tolist(), "values": rounded(flat[index]), "means": rounded(means(flat))}


def rounded(values: np.ndarray) -> list[float]:
    """Return numbers with eight significant digits."""
    return [float(f"{value:.8g}") for value in values.tolist()]


def means(flat: np.ndarray) -> np.ndarray:
    """Return the mean, and the mean with weights ((7919 i) mod 1009) / 1008, which depends on the order."""
    weights = (7919 * np.arange(flat.size) % 1009) / 1008
    return np.array([flat.mean(dtype=float), (flat * weights).mean()])


def differences(case: str, arrays: dict[str, np.ndarray], for_display: bool = False) -> list[str]:
    """Return one line per array of a case that is missing or wrong.

    Args:
        case: Name of the case.
        arrays: Decoded arrays.
        for_display: The decoder quantizes offsets for a graphics device, see README.md.
    """
    wanted = expected(case)
    wrong = [f"{case}: {name} is missing" for name in wanted["arrays"] if name not in arrays]
    for name, entry in wanted["arrays"].items():
        if name in arrays:
            slack = entry.get("display", 0.0) if for_display else 0.0
            wrong += [f"{case}: {name} {why}" for why in mistakes(arrays[name], entry, wanted["tolerance"], slack)]
    return wrong


def mistakes(array: np.ndarray, entry: dict[str, Any], tolerance: float, slack: float) -> list[str]:
    """Return what is wrong with an array."""
    if list(array.shape) != entry["shape"]:
        return [f"has the shape {list(array.shape)}, expected {entry['shape']}"]
    flat = array.ravel()
    if "crc32" in entry:
        found = zlib.crc32(flat.astype(np.uint8).tobytes())
        return [] if found == entry["crc32"] else [f"has the CRC-32 {found}, expected {entry['crc32']}"]
    index = np.array(entry.get("index", range(flat.size)), int)
    pairs = [(f"at {i}", flat[i], value, max(1.0, abs(value))) for i, value in zip(index, entry["values"], strict=True)]
    if "means" in entry:
        size = float(np.maximum(np.abs(flat), 1).mean())
        pairs += [("mean", a, b, size) for a, b in zip(means(flat), entry["means"], strict=True)]
    return [
        f"{where} is {found:.7g}, expected {value:.7g}"
        for where, found, value, size in pairs
        if not abs(found - value) <= tolerance * size + slack
    ]


def main() -> int:
    """Print the result of each case. Return 1 if any fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", nargs="*", choices=[[], *cases()])
    parser.add_argument("--arrays", type=Path, help="folder with CASE.npz of another decoder")
    parser.add_argument("--display", action="store_true", help="allow quantized offsets")
    arguments = parser.parse_args()
    failed = 0
    for name in () if arguments.arrays or arguments.case else refused():
        with tempfile.TemporaryDirectory() as folder:
            write_refused(name, Path(folder) / name)
            reason = refusal_of(Path(folder) / name)
        failed += reason is None
        print(f"{name} is refused: {reason}" if reason else f"{name} is not refused: {refused()[name]['covers']}")
    for case in arguments.case or cases():
        wanted = expected(case)
        arrays = (
            dict(np.load(arguments.arrays / f"{case}.npz"))
            if arguments.arrays
            else arrays_of(HERE / case, wanted["times"], wanted["renditions"])
        )
        wrong = differences(case, arrays, arguments.display)
        failed += bool(wrong)
        print("\n".join(wrong) if wrong else f"{case}: {len(wanted['arrays'])} arrays are right")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
