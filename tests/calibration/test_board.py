import re
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from splatreel.base.errors import UsageError
from splatreel.calibration.board import Board, family_of_markers, parse_board, write_board
from splatreel.cli.main import main
from tests.capture.boards import FilmedBoard


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


KINDS = [Board(5, 7, 0.12), Board(6, 6, 0.12), Board(5, 6, 0.12, "5X5_100"), Board(8, 5, 0.1, "checkerboard")]
KINDS += [Board(5, 8, 0.1, "checkerboard")]


@pytest.fixture(scope="module")
def film() -> FilmedBoard:
    return FilmedBoard(pytest.importorskip("pycolmap"), [-20, 25])


def held(board: Board, roll: float, angle: float = 0.0) -> np.ndarray:
    """Return a pose [3, 4] of a board in the middle, turned about the line of sight."""
    turn = Rotation.from_euler("yxz", [angle, 12, roll], degrees=True).as_matrix()
    return np.column_stack([turn, -turn @ [board.columns * board.square / 2, board.rows * board.square / 2, 0]])


@pytest.mark.parametrize("board", KINDS, ids=lambda board: board.spec)
def test_corners_have_their_places_however_the_board_is_turned(film: FilmedBoard, board: Board) -> None:
    """The corners of a checkerboard may be counted from its other end, but then in all images."""
    ends = set()
    for name, roll in [("cam00", 0), ("cam01", 90), ("cam00", 200)]:
        pose = held(board, roll)
        sighting, known = board.find(film.image(name, board, pose)).sighting, film.places(name, board, pose)
        assert sighting is not None
        assert len(sighting.corners) > 0.8 * len(board.points)
        off = [
            np.median(np.linalg.norm(order[sighting.corners] - sighting.places, axis=1))
            for order in (known, known[::-1])
        ]
        assert min(off) < 0.5
        ends.add(off[0] < off[1])
    assert len(ends) == 1
    assert ends == {True} or board.kind == "checkerboard"


@pytest.mark.parametrize("rows", [6, 7])
def test_patterns_of_older_opencv_are_found(film: FilmedBoard, rows: int) -> None:
    """Before 4.6, boards with an even number of rows began with a white square."""
    cv2, board = pytest.importorskip("cv2"), Board(5, rows, 0.12)
    old = cv2.aruco.CharucoBoard((5, rows), 0.12, 0.09, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    old.setLegacyPattern(True)
    printed = old.generateImage((40, 8 * rows)) > 127
    assert (printed == board.cells()).all() == (rows == 7)
    pose = held(board, 0)
    sighting = board.find(film.image("cam00", board, pose, printed)).sighting
    assert sighting is not None
    off = film.places("cam00", board, pose)[sighting.corners] - sighting.places
    assert np.median(np.linalg.norm(off, axis=1)) < 0.5


@pytest.mark.parametrize(
    ("spec", "shown", "said"),
    [
        ("6x7:0.12", "5x7:0.12", "markers in another order"),
        ("7x5:0.12", "5x7:0.12", "markers in another order"),
        ("4x4:0.12", "5x7:0.12", "numbers up to 16, and that board has none above 7"),
        ("8x5:0.1:checkerboard", "9x6:0.1:checkerboard", "a checkerboard of (9 x 6|6 x 9) squares"),
    ],
)
def test_another_board_is_named(film: FilmedBoard, spec: str, shown: str, said: str) -> None:
    board, other = parse_board(spec), parse_board(shown)
    look = board.find(film.image("cam00", other, held(other, 0)))
    assert look.sighting is None
    assert re.search(said, look.other or "")


def test_images_without_a_board_have_none() -> None:
    blobs = np.random.default_rng(0).integers(0, 255, (12, 16, 3), np.uint8).repeat(10, 0).repeat(10, 1)
    for board in KINDS:
        assert board.find(blobs).sighting is None
    assert family_of_markers(blobs) is None


def test_the_dictionary_of_another_board_is_found(film: FilmedBoard) -> None:
    board = parse_board("5x7:0.12:6X6_250")
    assert family_of_markers(film.image("cam00", board, held(board, 0))) == "6X6_1000"


HOSTILE = [
    "5x7:nan",
    "5x7:inf",
    "5x7:-1",
    "5x7:1e-2",
    "5x7:",
    "\uff15x7:0.035",
    "5x7:0.035:4X4_50\n",
    "5x7:0.035:__class__",
    "5x7:" + "9" * 100_000,
    "5x7:" + "9" * 100_000 + "x",
    "5x7:0." + "9" * 100_000 + "x",
    "5x7:0.035:" + "A" * 100_000,
    "9" * 100_000 + "x7:1",
]


@pytest.mark.parametrize("spec", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_boards_are_refused_at_once(spec: str) -> None:
    before = time.process_time()
    with pytest.raises(UsageError) as caught:
        parse_board(spec)
    assert time.process_time() - before < 2
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize("spec", ["5x7:0.035", "10x7:0.025:checkerboard", "30x40:0.1:5X5_1000"])
def test_a_board_has_a_text(spec: str) -> None:
    assert parse_board(spec).spec == spec


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("5x7", "'5x7' is not understood. Write columns x rows : meters"),
        ("5x7:35mm", "is not understood"),
        ("2x7:0.035", "3 to 40 are possible"),
        ("5x7:35", "squares of 35 meters, not 0.001 to 5"),
        ("6x8:0.03:checkerboard", "looks alike if it is turned by half"),
        ("20x20:0.03", "has 50 markers, and the board '20x20:0.03' 200. Use a larger one, such as 20x20:0.03:4X4_1000"),
        ("5x7:0.03:chess", "'chess' is not a kind of board. There are checkerboard and the dictionaries 4X4_100,"),
    ],
)
def test_impossible_boards_are_refused(spec: str, said: str) -> None:
    with pytest.raises(UsageError) as error:
        parse_board(spec)
    assert said in str(error.value)
