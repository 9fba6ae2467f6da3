"""Printing of calibration boards as PDF, SVG or PNG files of exact size."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import UsageError
from splatreel.calibration.boards.board import Board

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
