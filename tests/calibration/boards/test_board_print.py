import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import UsageError
from splatreel.calibration.boards.board import parse_board
from splatreel.calibration.boards.board_print import write_board
from splatreel.cli.main import main


def test_a_png_board_has_its_size_and_is_found(tmp_path: Path) -> None:
    board = parse_board("5x7:0.035")
    width, height = write_board(board, tmp_path / "board.png")
    image = Image.open(tmp_path / "board.png")
    assert (width, height) == (pytest.approx(6 * 0.035), pytest.approx(8 * 0.035)), "half a square of margin"
    assert image.width / image.info["dpi"][0] * 0.0254 == pytest.approx(width, rel=1e-3)
    sighting = board.find(np.asarray(image.convert("RGB").resize((600, 800)))).sighting
    assert sighting is not None
    assert np.allclose(sighting.places, (board.points[:, :2] / 0.035 + 0.5) * 100, atol=1)


def test_a_pdf_board_has_its_size(tmp_path: Path) -> None:
    width, height = write_board(parse_board("10x7:0.025:checkerboard"), tmp_path / "board.pdf")
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", (tmp_path / "board.pdf").read_bytes())
    assert box is not None
    assert [float(side) / 72 * 0.0254 for side in box.groups()] == pytest.approx([width, height], rel=1e-3)
    assert (width, height) == (pytest.approx(11 * 0.025), pytest.approx(8 * 0.025))


@pytest.mark.parametrize("spec", ["5x7:0.035", "4x6:0.05:5X5_100", "10x7:0.025:checkerboard"])
def test_an_svg_board_is_drawn_cell_by_cell(tmp_path: Path, spec: str) -> None:
    board = parse_board(spec)
    write_board(board, tmp_path / "board.svg")
    text = (tmp_path / "board.svg").read_text()
    white = np.ones([side + 2 * (board.square_cells // 2) for side in board.cells().shape], bool)
    for x, y, length in re.findall(r"M(\d+) (\d+)h(\d+)v1", text):
        white[int(y), int(x) : int(x) + int(length)] = False
    edge = board.square_cells // 2
    assert (white[edge:-edge, edge:-edge] == board.cells()).all()
    assert white.sum() - board.cells().sum() == white.size - board.cells().size
    assert f'width="{(board.columns + 2 * edge / board.square_cells) * board.square * 1000:g}mm"' in text


def test_other_formats_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"boards are written as \.pdf, \.svg, \.png"):
        write_board(parse_board("5x7:0.035"), tmp_path / "board.jpg")


def test_the_command_tells_how_to_use_the_board(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["capture", "board", str(tmp_path / "board.pdf")]) == 0
    said = capsys.readouterr().out
    assert "5 x 7 squares of 35 mm, 210 x 280 mm with its margin" in said
    assert "splatreel capture calibrate CAPTURE --board 5x7:0.035" in said
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
