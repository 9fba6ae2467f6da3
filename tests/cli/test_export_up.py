"""The up axis of exported files, of a reel whose up axis is y."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.cli.main import main
from splatreel.formats.ply import read_ply
from splatreel.formats.spz import read_spz
from splatreel.play.timeline import open_reel
from tests.importing.films import frame, write_film


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reel")
    film = write_film(folder / "film", [frame(0)])
    assert main(["import", str(film), "--out", str(folder / "reel"), "--up", "y"]) == 0
    return folder / "reel"


def exported(reel: Path, out: Path, *options: str) -> np.ndarray:
    """Return the positions in an exported file, with its own axes."""
    assert main(["export", str(reel), "--frame", "0", "--out", str(out), *options]) == 0
    if out.suffix == ".ply":
        return read_ply(out).means
    columns = read_spz(out)
    return np.stack([columns[name] for name in "xyz"], 1)


@pytest.mark.parametrize(
    ("name", "options", "axes"),
    [
        ("f.ply", (), [1, -1, -1]),
        ("f.spz", (), [1, 1, 1]),
        ("f.ply", ("--up", "capture"), [1, 1, 1]),
        ("f.ply", ("--up", "y"), [1, 1, 1]),
        ("f.spz", ("--up", "-y"), [1, -1, -1]),
    ],
)
def test_up_is_where_the_format_has_it(
    reel: Path, tmp_path: Path, name: str, options: tuple[str, ...], axes: list[int]
) -> None:
    found = exported(reel, tmp_path / name, *options)
    np.testing.assert_allclose(found, open_reel(reel).at(0).means * axes, atol=1e-5)


def test_other_axes_are_rotations(reel: Path, tmp_path: Path) -> None:
    means = open_reel(reel).at(0).means
    found = exported(reel, tmp_path / "f.ply", "--up", "z")
    np.testing.assert_allclose(found[:, 2], means[:, 1], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.linalg.norm(means, axis=1), atol=1e-5)


@pytest.mark.parametrize("name", ["f.html", "f.mp4"])
def test_up_is_for_files_of_gaussians(
    reel: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(reel), "--out", str(tmp_path / name), "--up", "z"]) == 2
    assert "--up" in capsys.readouterr().err
