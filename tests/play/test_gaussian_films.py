"""All frames of a reel in one file: USD, and .4dgs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.evaluation.metrics import psnr
from splatreel.formats.fourdgs import FourdgsScene
from splatreel.formats.fourdgs_writer import write_fourdgs
from splatreel.formats.usd import estimate_bytes, write_usd
from splatreel.kernels.image import render_image
from splatreel.play.gaussian_export import GaussianExport
from splatreel.play.timeline import open_reel
from splatreel.scene.gaussians import Gaussians, turned
from splatreel.scene.volumes import Box
from tests.golden import PREDICTIVE, camera


@pytest.fixture
def film() -> GaussianExport:
    """Return all frames of a golden reel, with y up."""
    source = open_reel(PREDICTIVE)
    return GaussianExport(source, [frame / source.fps for frame in range(source.frames)], np.array([0.0, 1, 0]))


def frame_of(film: GaussianExport, frame: int) -> Gaussians:
    return turned(film.at(film.seconds[frame]), film.placement.turn)


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_usd_states_meters_and_srgb_and_is_about_as_large_as_estimated(
    tmp_path: Path, film: GaussianExport, suffix: str
) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom  # pyright: ignore[reportMissingImports] - optional

    path = tmp_path / f"f{suffix}"
    write_usd(path, film, 30)
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.StageHasAuthoredMetersPerUnit(stage)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    splats = stage.GetDefaultPrim()
    colors = splats.GetAttribute("radiance:sphericalHarmonicsCoefficients")
    assert Usd.ColorSpaceAPI(splats).GetColorSpaceNameAttr().Get() == "srgb_rec709_scene"
    assert colors.GetColorSpace() == "srgb_rec709_scene"
    assert UsdGeom.Primvar(colors).GetInterpolation() == "vertex"
    assert UsdGeom.Primvar(colors).GetElementSize() == frame_of(film, 0).sh.shape[1]
    size = path.stat().st_size
    assert 0.7 * size < estimate_bytes(path, film) < 1.4 * size


@pytest.mark.parametrize("suffix", [".usdc", ".usdz"])
def test_usd_has_the_points_of_every_frame(tmp_path: Path, film: GaussianExport, suffix: str) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdVol  # pyright: ignore[reportMissingImports] - optional

    path = tmp_path / f"f{suffix}"
    write_usd(path, film, 30)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    stage = Usd.Stage.Open(str(path))
    assert (UsdGeom.GetStageUpAxis(stage), stage.GetTimeCodesPerSecond()) == ("Y", 30)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, len(film.seconds) - 1)
    splats = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    for frame in (0, 1, 5, 6, 7, len(film.seconds) - 1):
        points = frame_of(film, frame)
        np.testing.assert_allclose(splats.GetPositionsAttr().Get(frame), points.means, rtol=1e-6)
        np.testing.assert_allclose(splats.GetScalesAttr().Get(frame), points.scales, rtol=1e-6)
        np.testing.assert_allclose(splats.GetOpacitiesAttr().Get(frame), points.opacities, rtol=1e-6)
        turn = splats.GetOrientationsAttr().Get(frame)[0]
        np.testing.assert_allclose([turn.GetReal(), *turn.GetImaginary()], points.quats[0], rtol=1e-6)
        harmonics = np.array(splats.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(frame))
        np.testing.assert_allclose(harmonics.reshape(points.sh.shape), points.sh, rtol=1e-5)
    assert np.array_equal(np.array(splats.GetPositionsAttr().Get()), frame_of(film, 0).means)


def test_usd_with_equal_counts_interpolates_within_and_between_groups(tmp_path: Path, film: GaussianExport) -> None:
    """USD interpolates between samples of one length. Without equal counts it holds them where the length changes."""
    pytest.importorskip("pxr")
    from pxr import Usd, UsdVol  # pyright: ignore[reportMissingImports] - optional

    path = tmp_path / "f.usdc"
    equal = replace(film, equal_counts=True)
    write_usd(path, equal, 30)
    stage = Usd.Stage.Open(str(path))
    splats = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    frames = [turned(points, film.placement.turn) for points in equal]
    for frame in range(len(frames) - 1):
        between = (frames[frame].opacities + frames[frame + 1].opacities) / 2
        np.testing.assert_allclose(splats.GetOpacitiesAttr().Get(frame + 0.5), between, atol=1e-6)


def test_fourdgs_shows_the_points_of_every_frame_and_stores_resting_points_once(
    tmp_path: Path, film: GaussianExport
) -> None:
    pytest.importorskip("fourdgs")
    path = tmp_path / "f.4dgs"
    write_fourdgs(path, film, film.source.fps)
    scene = FourdgsScene(path, film.source.fps)
    assert len(scene) == len(film.seconds)
    for frame in range(len(scene)):
        points, back = frame_of(film, frame), scene.read(frame)
        assert len(back) == len(points)
        assert np.abs(np.sort(points.means[:, 0]) - np.sort(back.means[:, 0])).max() < 0.01
    assert scene._scene.gaussians.count < 0.8 * sum(len(points) for points in film)


def test_fourdgs_is_valid_for_its_own_package_and_looks_like_the_reel(tmp_path: Path, film: GaussianExport) -> None:
    """Read all points of a time from the chunks that the index names for it."""
    pytest.importorskip("fourdgs")
    from fourdgs import indexed_reader, readable, validate  # pyright: ignore[reportMissingImports] - optional

    path = tmp_path / "f.4dgs"
    write_fourdgs(path, film, film.source.fps)
    data = path.read_bytes()
    assert validate.validate(data).findings == []
    scene, file = FourdgsScene(path, film.source.fps), readable.BytesReadable(data)
    index = indexed_reader.open_indexed(file)
    windows = np.array(index.windows)
    for frame in range(len(scene)):
        seconds = (frame + 0.5) / film.source.fps
        chunks = [indexed_reader.read_chunk(file, index, entry) for entry in index.chunks_for_time(seconds)]
        begin, end = windows[np.concatenate([chunk["window_index"] for chunk in chunks])].T
        points, back = frame_of(film, frame), scene.read(frame)
        assert np.sum((begin <= seconds) & (seconds < end)) == len(back)
        images = [
            np.clip(render_image(turned(shown, undone(film.placement.turn)), camera("c", 0.2)), 0, 1)
            for shown in (points, back)
        ]
        assert images[0].std() > 0.05
        assert psnr(images[1], images[0]) > 30


def undone(turn: np.ndarray) -> np.ndarray:
    return turn * [1, -1, -1, -1]


def test_crop_keeps_what_is_in_the_box(film: GaussianExport) -> None:
    points = film.source.at(0)
    low, high = np.quantile(points.means, [0.2, 0.8], axis=0)
    cropped = GaussianExport(film.source, [0.0], None, Box(low, high)).at(0)
    inside = ((points.means >= low) & (points.means <= high)).all(1)
    assert 0 < len(cropped) == inside.sum() < len(points)
