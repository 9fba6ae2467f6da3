"""Calibration boards: ChArUco boards and checkerboards, which OpenCV finds in images."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import UsageError
from splatreel.capture.lens import import_cv2

MARGIN = 0.5
"""White margin around the board, in squares. Detectors need some."""
INCH = 0.0254
CELL = 16
"""Pixels of a cell in PNG and PDF files."""
FORMATS = (".pdf", ".svg", ".png")


def write_board(board: Board, file: Path) -> tuple[float, float]:
    """Write a board whose squares have their size in print, and return the width and height of the page in meters.

    Raises:
        UsageError: The file's extension is not .pdf, .svg or .png.
    """
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        raise UsageError(f"{file}: boards are written as {', '.join(FORMATS)}. Choose one of these extensions.")
    margin = round(MARGIN * board.square_cells)
    cells = np.pad(board.cells(), margin, constant_values=True)
    cell = board.square / board.square_cells
    if suffix == ".svg":
        write_bytes(file, _svg(cells, 1000 * cell).encode())
    else:
        pixels = Image.fromarray(np.kron(cells, np.ones((CELL, CELL), bool)).astype(np.uint8) * 255)
        dots, made = CELL * INCH / cell, io.BytesIO()
        if suffix == ".pdf":
            pixels.save(made, "PDF", resolution=dots)
        else:
            pixels.save(made, "PNG", dpi=(dots, dots))
        write_bytes(file, made.getvalue())
    return cells.shape[1] * cell, cells.shape[0] * cell


def _svg(cells: np.ndarray, cell: float) -> str:
    """Return cells [H, W] bool as SVG with a path of the black runs. `cell`: millimeters."""
    height, width = cells.shape
    runs = []
    for y, row in enumerate(np.pad(~cells, ((0, 0), (1, 1))).astype(np.int8)):
        edges = np.diff(row)
        starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        runs += [f"M{x} {y}h{end - x}v1h{x - end}z" for x, end in zip(starts, ends, strict=True)]
    size = f'width="{width * cell:g}mm" height="{height * cell:g}mm" viewBox="0 0 {width} {height}"'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} shape-rendering="crispEdges">\n'
        f'<rect width="{width}" height="{height}" fill="#fff"/>\n<path d="{"".join(runs)}"/>\n</svg>\n'
    )


CHECKERBOARD = "checkerboard"
DICTIONARY = "4X4_50"
"""Default dictionary of markers. Coarse markers are found at the greatest distance."""
FAMILIES = ("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL")
"""Dictionaries that hold most others, to name that of an unknown board."""
SPEC = re.compile(r"(\d{1,3})x(\d{1,3}):(\d{1,9}|\d{0,9}\.\d{1,20})(?::(\w{1,40}))?", re.ASCII)
FEWEST = 6
"""Minimum number of corners of a sighting."""
MARKERS = 4
"""Minimum number of markers that tell what board an image shows."""
FLAT = 0.25
"""Maximum distance of a corner from its place on a plane, as a share of a square. Lenses bend boards by less."""
BORDER = 1
"""Cells around the bits of a marker, black, and around these, white. A marker of 4 x 4 bits has a square of 8 x 8 cells."""


@dataclass(frozen=True)
class Sighting:
    """Corners of a board in one image.

    Attributes:
        corners: Numbers of the corners, [N] int.
        places: Their places in pixels, [N, 2] float64; the center of the first pixel is (0.5, 0.5).
    """

    corners: np.ndarray
    places: np.ndarray


@dataclass(frozen=True)
class Look:
    """Result of a search for a board in one image.

    Attributes:
        sighting: The corners, or None.
        other: Phrase about what the image shows in place of the board; None if it shows nothing of the kind.
    """

    sighting: Sighting | None
    other: str | None = None


@dataclass(frozen=True)
class Board:
    """Flat board of black and white squares.

    Attributes:
        columns: Number of squares in a row.
        rows: Number of rows of squares.
        square: Side of a square in meters.
        kind: OpenCV's name of the dictionary of a ChArUco board's markers, or "checkerboard".
    """

    columns: int
    rows: int
    square: float
    kind: str = DICTIONARY

    @property
    def spec(self) -> str:
        """Text that `parse_board` reads."""
        return f"{self.columns}x{self.rows}:{self.square:g}" + ("" if self.kind == DICTIONARY else f":{self.kind}")

    @property
    def points(self) -> np.ndarray:
        """Inner corners in meters, row by row, [N, 3]; x along the rows, y down, z into the board."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1) * self.square

    def find(self, image: np.ndarray) -> Look:
        """Search an image [H, W, 3] uint8 for the board."""
        cv2 = import_cv2("Finding a board")
        gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        look = self._find_checkerboard(cv2, gray) if self.kind == CHECKERBOARD else self._find_charuco(gray)
        if look.sighting is not None and not self._is_flat(cv2, look.sighting):
            return Look(None, "a pattern that is bent or of another kind")
        return look

    @property
    def square_cells(self) -> int:
        """Number of printed cells along the side of a square."""
        return 2 if self.kind == CHECKERBOARD else dictionary(self.kind).markerSize + 4 * BORDER

    def cells(self) -> np.ndarray:
        """Return the board as cells of black (False) and white (True), [rows * square_cells, columns * square_cells]."""
        side = self.square_cells
        if self.kind == CHECKERBOARD:
            row, column = np.indices((self.rows * side, self.columns * side)) // side
            return (row + column) % 2 == 1
        size = self.columns * side, self.rows * side
        return self._detectors[0].getBoard().generateImage(size, marginSize=0, borderBits=BORDER) > 127

    def _find_charuco(self, gray: np.ndarray) -> Look:
        largest = -1
        for detector in self._detectors:
            places, numbers, _, markers = detector.detectBoard(gray)
            if numbers is not None and len(numbers) >= FEWEST:
                return Look(Sighting(numbers.ravel().astype(int), places.reshape(-1, 2).astype(np.float64) + 0.5))
            if markers is None or len(markers) < MARKERS:
                return Look(None)
            largest = int(markers.max())
        last = self.columns * self.rows // 2 - 1
        if largest > last:
            return Look(None, f"markers with numbers up to {largest}, and that board has none above {last}")
        return Look(None, "its markers in another order, as on a board with another number of columns")

    def _find_checkerboard(self, cv2: Any, gray: np.ndarray) -> Look:
        """Search for a checkerboard. A larger one is found as a whole, so that no part of it is taken for the board."""
        flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, places, shape = cv2.findChessboardCornersSBWithMeta(gray, (self.columns - 1, self.rows - 1), flags)
        if not found:
            return Look(None)
        down, across = (count + 1 for count in shape.shape)
        if (across, down) != (self.columns, self.rows):
            return Look(None, f"a checkerboard of {across} x {down} squares")
        return Look(Sighting(np.arange(len(self.points)), np.asarray(places, np.float64).reshape(-1, 2) + 0.5))

    def _is_flat(self, cv2: Any, sighting: Sighting) -> bool:
        """Return whether corners are the image of a plane, up to the distortion of a lens."""
        plane = self.points[sighting.corners, :2] / self.square
        if np.linalg.matrix_rank(plane - plane.mean(0), 0.5) < 2:
            return False
        back, _ = cv2.findHomography(sighting.places, plane, 0)
        if back is None:
            return False
        shown = cv2.perspectiveTransform(sighting.places[None], back)[0]
        return bool(np.linalg.norm(shown - plane, axis=1).max() < FLAT)

    @cached_property
    def _detectors(self) -> list[Any]:
        """Detectors of the pattern of OpenCV from 4.6 on and of older ones, which differ for an even number of rows."""
        aruco = import_cv2("Finding a board").aruco
        made, markers = [], dictionary(self.kind)
        # Corners are in the middle between markers of any size.
        marker = self.square * (1 - 2 * BORDER / self.square_cells)
        for legacy in (False, True) if self.rows % 2 == 0 else (False,):
            board = aruco.CharucoBoard((self.columns, self.rows), self.square, marker, markers)
            board.setLegacyPattern(legacy)
            made.append(aruco.CharucoDetector(board))
        return made


def parse_board(text: str) -> Board:
    """Return the board of a text such as 5x7:0.035, 5x7:0.035:5X5_100 or 10x7:0.025:checkerboard.

    Raises:
        UsageError: The text is not of that form, or names a board that cannot be told from a turned one or does not exist.
    """
    form = "Write columns x rows : meters of a square, such as 5x7:0.035, and :checkerboard for one without markers"
    match = SPEC.fullmatch(text)
    if match is None:
        raise UsageError(f"the board {text!r:.60} is not understood. {form}.")
    columns, rows, square = int(match[1]), int(match[2]), float(match[3])
    board = Board(columns, rows, square, match[4] or DICTIONARY)
    if min(columns, rows) < 3 or max(columns, rows) > 40:
        raise UsageError(f"the board {text!r} has {columns} x {rows} squares; 3 to 40 are possible each way. {form}.")
    if not 0.001 <= square <= 5:
        raise UsageError(
            f"the board {text!r} has squares of {square:g} meters, not 0.001 to 5. Give their side in meters."
        )
    if board.kind == CHECKERBOARD:
        if (columns + rows) % 2 == 0:
            raise UsageError(
                f"a checkerboard of {columns} x {rows} squares looks alike if it is turned by half. Use one with an odd number of "
                f"squares one way and an even number the other way, or a ChArUco board."
            )
        return board
    size = len(dictionary(board.kind).bytesList)
    if columns * rows // 2 > size:
        raise UsageError(
            f"the dictionary {board.kind} has {size} markers, and the board {text!r} {columns * rows // 2}. Use a larger one, "
            f"such as {board.spec.split(':')[0]}:{square:g}:4X4_1000."
        )
    return board


def dictionary(kind: str) -> Any:
    """Return OpenCV's dictionary of markers by its name. Raise `UsageError` for an unknown name."""
    aruco = import_cv2("Finding a board").aruco
    number = getattr(aruco, f"DICT_{kind}", None)
    if number is None:
        known = ", ".join(sorted(name.removeprefix("DICT_") for name in dir(aruco) if name.startswith("DICT_")))
        raise UsageError(f"{kind!r} is not a kind of board. There are {CHECKERBOARD} and the dictionaries {known}.")
    return aruco.getPredefinedDictionary(number)


def family_of_markers(image: np.ndarray) -> str | None:
    """Return the dictionary of most markers in an image [H, W, 3] uint8, or None if it shows too few of any."""
    cv2 = import_cv2("Finding a board")
    gray, counts = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), {}
    for family in FAMILIES:
        _, numbers, _ = cv2.aruco.ArucoDetector(dictionary(family)).detectMarkers(gray)
        counts[family] = 0 if numbers is None else len(numbers)
    best = max(counts, key=lambda family: counts[family])
    return best if counts[best] >= MARKERS else None
