"""Matrices, numbers and strings of files that OpenCV's FileStorage wrote, in YAML or XML.

OpenCV's own parser is not used, because it can crash on damaged files.

Source: OpenCV's documentation of `cv::FileStorage`, and files that OpenCV 4 and 5 wrote.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.readers.calibrations.calibrated_rig import naming, read_text, read_xml

MATRIX = re.compile(
    r"^([\w.-]+):\s*!!opencv-(?:nd-)?matrix\s+(rows:\s*\d+\s+cols:\s*\d+|sizes:\s*\[[^\[\]]*\])\s+dt:\s*\S+\s+data:\s*"
    r"\[([^\[\]]*)\]",  # an unclosed bracket ends at the next one, so that the search stays linear
    re.MULTILINE,
)
SCALAR = re.compile(r"^([\w.-]+):[ \t]*([^\s!\[{\"][^\n]*)$", re.MULTILINE)
TEXT = re.compile(r'^(\w+):[ \t]*"([^"\n]*)"[ \t]*$', re.MULTILINE)
LIST = re.compile(r"^(\w+):[ \t]*((?:\n[ \t]+-[^\n]*)+|\[[^\[\]]*\])", re.MULTILINE)
ENTRY = re.compile(r'"([^"]*)"|([^\s,\[\]"]+)')


class OpenCVStorage:
    """Content of a file by key. Values of other kinds are ignored.

    Attributes:
        known: Keys of all values that were recognized.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self._matrices: dict[str, tuple[list[int], str]] = {}
        self._scalars: dict[str, str] = {}
        self._strings: dict[str, list[str]] = {}
        with naming(str(file)):
            if file.suffix.lower() == ".xml":
                for node in read_xml(file):
                    self._add_xml(node)
            else:
                self._add_yaml(read_text(file).replace("\r\n", "\n"))
        self.known = {*self._matrices, *self._scalars, *self._strings}

    def first(self, keys: tuple[str, ...]) -> np.ndarray | None:
        """Return the first existing matrix or number, or None."""
        return next((self.matrix(key) for key in keys if key in self._matrices or key in self._scalars), None)

    def matrix(self, key: str) -> np.ndarray:
        """Return a matrix or a number as float64.

        Raises:
            CaptureError: It is missing, or not of finite numbers.
        """
        with naming(f"{self.file}: {key}"):
            if key in self._scalars:
                return np.array(self.number(key))
            if key not in self._matrices:
                raise CaptureError(f"{self.file}: has no matrix {key}. Export the calibration again.")
            shape, text = self._matrices[key]
            values = np.array(text.replace(",", " ").split(), np.float64)
            if not np.isfinite(values).all() or len(values) == 0 or len(values) % max(math.prod(shape), 1):
                raise ValueError(f"{len(values)} numbers for the shape {shape}, or not finite ones")
            return values.reshape(shape if len(values) == math.prod(shape) else [*shape, -1])

    def number(self, key: str) -> float | None:
        """Return a number, or None if there is no such key.

        Raises:
            CaptureError: The value is not a finite number.
        """
        text = self._scalars.get(key)
        if text is None:
            return None
        with naming(f"{self.file}: {key} is {text[:40]!r}, no finite number"):
            if not math.isfinite(value := float(text)):
                raise ValueError("it is infinite or NaN")
            return value

    def strings(self, key: str) -> list[str]:
        """Return a list of strings, which older versions wrote as one string with commas."""
        found = self._strings.get(key, [])
        return [part.strip() for part in found[0].split(",")] if len(found) == 1 else found

    def _add_yaml(self, text: str) -> None:
        for key, shape, data in MATRIX.findall(text):
            self._matrices[key] = [int(number) for number in re.findall(r"\d+", shape)], data
        self._scalars = {key: value.rstrip(" \t") for key, value in SCALAR.findall(text)}
        self._strings = {key: _entries(part) for key, part in LIST.findall(text)}
        self._strings |= {key: [value] for key, value in TEXT.findall(text)}

    def _add_xml(self, node: Element) -> None:
        data = node.findtext("data")
        if data is None:
            text = " ".join(node.itertext()).strip()
            self._strings[node.tag] = [first or second for first, second in ENTRY.findall(text)]
            if re.fullmatch(r"[-+.\deE]+", text):
                self._scalars[node.tag] = text
            return
        sizes = node.findtext("sizes") or f"{node.findtext('rows', '')} {node.findtext('cols', '')}"
        self._matrices[node.tag] = [int(number) for number in re.findall(r"\d+", sizes)], data


def _entries(text: str) -> list[str]:
    """Return the entries of a list in lines with dashes or in brackets."""
    text = text.strip()
    parts = text[1:-1].split(",") if text.startswith("[") else [line.strip()[1:] for line in text.splitlines()]
    return [part.strip().strip('"') for part in parts if part.strip()]
