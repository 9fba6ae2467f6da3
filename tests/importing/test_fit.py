"""Fit of moving points to frames that were trained independently."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.base.progress import Silent
from splatreel.cli.main import main
from splatreel.codec.header import ReelHeader
from splatreel.config.settings import changed
from splatreel.importing.fit import FilmCapture, fit_config, fit_reel, steadied
from splatreel.importing.frames import Frames, open_frames
from splatreel.importing.reel import header_of
from splatreel.importing.viewpoints import dome
from splatreel.play.timeline import open_reel
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.reel_source import ReelSource
from tests.importing.films import cameras, frame, write_film

FRAMES = 4


def perturbed(number: int) -> Gaussians:
    """Return a frame whose points have their own order and noise, as if it was trained on its own."""
    rng, points = np.random.default_rng(number), frame(number)
    noise = 0.2 * points.scales.mean(1, keepdims=True) * rng.normal(size=points.means.shape)
    scales = points.scales * np.exp(0.1 * rng.normal(size=points.scales.shape))
    return replace(points, means=points.means + noise, scales=scales)[rng.permutation(len(points))]


@pytest.fixture
def film(tmp_path: Path) -> Frames:
    return open_frames(write_film(tmp_path / "film", [perturbed(number) for number in range(FRAMES)]))


def header(film: Frames) -> ReelHeader:
    return header_of(film.read(0), cameras(), None, 30.0)[0]


def test_capture_draws_the_frames_of_the_film(film: Frames) -> None:
    capture = FilmCapture(film, cameras(), header(film))
    assert (capture.frames, capture.fps, len(capture.cameras)) == (FRAMES, 30, 5)
    names = [camera.name for camera in capture.cameras]
    whole = capture.read(0, FRAMES, names)
    assert np.array_equal(capture.read(2, 1, names[1:2])[0, 0], whole[2, 1])
    assert whole.std() > 20
    assert np.abs(whole[0].astype(float) - whole[3]).mean() > 1
    assert capture.reel_source() == ReelSource(None)  # its frames are not those of a capture


def test_another_film_has_another_fingerprint(film: Frames, tmp_path: Path) -> None:
    other = open_frames(write_film(tmp_path / "other" / "film", [perturbed(number + 9) for number in range(FRAMES)]))
    marks = {FilmCapture(one, cameras(), header(film)).fingerprint() for one in (film, film, other)}
    assert len(marks) == 2


def test_images_are_steadied_where_they_flicker_only() -> None:
    rng = np.random.default_rng(0)
    clean = np.full((48, 64, 3), 120.0)
    images = np.stack([clean + 12 * rng.normal(size=clean.shape) for _ in range(6)])
    images[0, :16, :16] += 100
    images = np.clip(images, 0, 255).astype(np.uint8)
    found = steadied(images).astype(float)
    still, moving = np.s_[24:, 24:], np.s_[4:12, 4:12]
    assert np.abs(found[still] - clean[still]).mean() < 0.6 * np.abs(images[0][still] - clean[still]).mean()
    assert np.abs(found[moving] - images[0][moving]).max() <= 1


def test_dome_has_three_rings(film: Frames) -> None:
    views = dome(film.read(0), np.array([0.0, -1, 0]))
    assert len({view.name for view in views}) == len(views) == 36
    assert len({round(float(view.center[1]), 3) for view in views}) == 3


def test_film_far_from_its_origin_is_refused(film: Frames, tmp_path: Path) -> None:
    far = replace(header(film), origin=np.array([5.4e6, 0, 0]))
    with pytest.raises(GaussiansError, match=r"lies near 5400000, 0, 0, .* without --fit"):
        fit_reel(film, cameras(), far, tmp_path / "out", fit_config("draft", "medium"), Silent())


@pytest.mark.slow
def test_fitted_reel_has_one_group_and_few_bytes(film: Frames, tmp_path: Path) -> None:
    few = {"keyframe.first_iterations": 150, "group.iterations_per_frame": 10}
    config = changed(fit_config("draft", "medium"), few)
    reel, found = fit_reel(film, cameras(), header(film), tmp_path / "out", config, Silent())
    assert len(open_reel(reel).manifest.groups) == 1
    assert found.psnr > 20


def test_import_suggests_a_fit(film: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", str(film.path), "--out", str(tmp_path / "reel")]) == 0
    assert "--fit standard makes a far smaller reel" in capsys.readouterr().out


def test_up_axis_of_a_fit_is_that_of_the_cameras(film: Frames, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--out", "reel", "--fit", "draft", "--cameras", "cameras.json", "--up", "y"]
    assert main(["import", str(film.path), *options]) == 2
    assert "Leave out --up" in capsys.readouterr().err
