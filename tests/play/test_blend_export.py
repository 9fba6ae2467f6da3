"""Files of Blender: the motion as vectors times curves, fades, cameras, and the scene that Blender evaluates."""

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from splatreel.base.errors import GaussiansError, MissingDependencyError, UsageError
from splatreel.cli.main import main
from splatreel.play import blend_export
from splatreel.play.blend_export import BlendScene, fit_motion, make_scene, rotation_changes, write_blend
from splatreel.play.film import CameraPath, Keyframe
from splatreel.play.gaussian_export import GaussianExport
from splatreel.play.timeline import open_reel
from splatreel.scene import rotations
from splatreel.scene.camera import project
from splatreel.scene.gaussians import turned
from splatreel.scene.volumes import Sphere
from tests import flashes
from tests.golden import PREDICTIVE


@pytest.fixture
def film() -> GaussianExport:
    """Return all frames of a golden reel, with z up."""
    source = open_reel(PREDICTIVE)
    return GaussianExport(source, [frame / source.fps for frame in range(source.frames)], np.array([0.0, 0, 1]))


def arrays_of(scene: BlendScene, name: str) -> dict[str, np.ndarray]:
    number = [entry["name"] for entry in scene.description["objects"]].index(name)
    return {key.split("/")[1]: array for key, array in scene.arrays.items() if key.startswith(f"{number}/")}


def test_motion_takes_as_few_vectors_as_its_rank() -> None:
    rng = np.random.default_rng(1)
    changes = np.einsum("tk,knc->tnc", rng.normal(size=(40, 5)), rng.normal(size=(5, 200, 3)))
    motion = fit_motion(changes, 1e-4)
    assert motion.curves.shape == (40, 5)
    found = np.einsum("tk,knc->tnc", motion.curves, motion.vectors)
    assert np.abs(found - changes).max() == pytest.approx(motion.error, rel=1e-3)
    assert motion.error <= 1e-4
    assert np.abs(motion.vectors).max() <= 1


def test_motion_of_full_rank_states_what_it_misses() -> None:
    changes = np.random.default_rng(2).normal(size=(60, 300, 1))
    motion = fit_motion(changes, 1e-3)
    assert motion.curves.shape == (60, blend_export.MOST_VECTORS)
    found = np.einsum("tk,knc->tnc", motion.curves, motion.vectors)
    assert np.abs(found - changes).max() == pytest.approx(motion.error, rel=1e-3)
    assert motion.error > 0.1


def test_no_motion_takes_no_vectors() -> None:
    assert fit_motion(np.zeros((4, 7, 3)), 0).curves.shape == (4, 0)
    assert fit_motion(np.zeros((4, 0, 3)), 0).vectors.shape == (0, 0, 3)


def test_rotation_vectors_are_continuous_beyond_half_a_turn() -> None:
    angles = np.linspace(0, 3 * np.pi, 31)
    quats = np.stack([np.cos(angles / 2), np.zeros(31), np.sin(angles / 2), np.zeros(31)], -1)[:, None]
    quats[::2] *= -1  # the same rotations
    rest, vectors = rotation_changes(quats)
    np.testing.assert_allclose(np.diff(vectors[:, 0, 1]), 0.1 * np.pi, atol=1e-9)
    found = rotations.multiply(rest, Rotation.from_rotvec(vectors[:, 0]).as_quat(scalar_first=True))
    np.testing.assert_allclose(np.abs(np.sum(found * quats[:, 0], axis=1)), 1, atol=1e-9)


def test_arrays_follow_the_reel(film: GaussianExport) -> None:
    scene, source = make_scene(film, 30), film.source
    turn = film.placement.turn
    for index, span in ((0, (0, 7)), (1, (6, 13))):
        arrays = arrays_of(scene, f"group {index}")
        entry = next(e for e in scene.description["objects"] if e["name"] == f"group {index}")
        assert entry["frames"] == span
        moved = arrays["position"] + np.einsum("tk,knc->tnc", arrays["position_curves"], arrays["position_vectors"])
        group = source.reel.group(index)
        for frame in range(span[0], span[1] + 1):
            want = turned(group.at(frame - group.first_frame), turn).means
            assert np.abs(moved[frame - span[0]] - want).max() < 2e-4 * np.linalg.norm(np.ptp(want, axis=0))
    weights = [source.groups_at(frame)[-1] for frame in range(source.frames)]
    np.testing.assert_allclose(scene.arrays["progress"], [group.index - 1 + weight for group, weight in weights])
    assert scene.arrays["light"][-1].tolist() == pytest.approx([0.8, 0.5, 0.4], abs=0.01)
    first = arrays_of(scene, "static 0")
    alive = [source.reel.group(index).alive[:150] for index in (0, 1)]
    assert len(first["position"]) == np.sum(alive[0] | alive[1])
    assert np.sum(first["shown_until"] == 0) == np.sum(alive[0] & ~alive[1])


def test_crop_keeps_what_is_inside_at_any_frame(film: GaussianExport) -> None:
    volume = Sphere(np.array([0.5, 0.2, 0]), 0.9)
    scene = make_scene(replace(film, crop=volume), 30)
    group = film.source.reel.group(0)
    inside = np.any([volume.contains(group.at(frame).means) for frame in range(8)], axis=0)
    assert 0 < inside.sum() < len(inside)
    assert len(arrays_of(scene, "group 0")["position"]) == inside.sum()


def test_cameras_see_what_the_cameras_of_the_reel_see(film: GaussianExport) -> None:
    scene = make_scene(film, 30)
    turn = rotations.to_matrix(film.placement.turn)
    points = np.random.default_rng(0).normal(size=(20, 3)) * 0.3
    cameras = [film.source.manifest.camera, *film.source.manifest.cameras]
    assert [entry["name"] for entry in scene.description["cameras"]] == ["start", "cam00", "cam01"]
    for number, (camera, entry) in enumerate(zip(cameras, scene.description["cameras"], strict=True)):
        pose = scene.arrays[f"camera{number}"][0]
        local = (points @ turn.T - pose[:3]) @ Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
        x, y = (local[:, :2] / -local[:, 2:]).T * entry["lens"] / 36  # in widths of the image
        pixels = np.stack([0.5 + x - entry["shift"][0], camera.height / camera.width / 2 - y + entry["shift"][1]], -1)
        np.testing.assert_allclose(pixels * camera.width, project(camera, points)[0], atol=1e-3)


def test_camera_path_at_another_speed_is_refused(film: GaussianExport) -> None:
    viewmat = film.source.manifest.camera.viewmat.astype(np.float64)
    path = CameraPath([Keyframe(0, 0, viewmat), Keyframe(0.4, 0.4, viewmat)])
    scene = make_scene(film, 30, path)
    assert scene.description["cameras"][0]["name"] == "path"
    np.testing.assert_allclose(scene.description["cameras"][0]["frames"], range(13), atol=1e-6)
    with pytest.raises(UsageError, match="slows the reel down"):
        make_scene(film, 30, CameraPath([Keyframe(0, 0, viewmat), Keyframe(0.8, 0.4, viewmat)]))


def test_without_blender_the_error_names_what_to_install(
    film: GaussianExport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match="pip install bpy"):
        write_blend(tmp_path / "f.blend", film, 30)


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in for Blender is a shell script")
def test_program_blender_gets_the_arrays_and_its_failure_is_shown(
    film: GaussianExport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "bin" / "blender"
    program.parent.mkdir()
    copy = tmp_path / "arrays.npz"
    program.write_text(
        f'#!/bin/sh\nfor last; do before=$now; now=$last; done\ncp "$before" "{copy}"\necho made > "$now"\n'
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:/usr/bin:/bin")
    assert main(["export", str(PREDICTIVE), "--out", str(tmp_path / "f.blend"), "--every", "2"]) == 0
    assert (tmp_path / "f.blend").read_text() == "made\n"
    assert "7 frames, frames 0 to 12, every 2" in capsys.readouterr().out
    with np.load(copy) as arrays:
        description = json.loads(str(arrays["scene"]))
    assert (description["fps"], description["frames"]) == (15, 7)
    program.write_text("#!/bin/sh\necho no space left >&2\nexit 3\n")
    (tmp_path / "f.blend").unlink()
    with pytest.raises(GaussiansError, match=r"blender ended with exit code 3[\s\S]*no space left"):
        write_blend(tmp_path / "f.blend", film, 30)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["arrays.npz", "bin"]


def test_sound_is_written_without_loss(tmp_path: Path) -> None:
    sound = open_reel(flashes.GOLDEN).sound
    assert sound is not None
    file = tmp_path / "sound.flac"
    blend_export._write_sound(file, sound, 0.25, 0.5)
    with av.open(str(file)) as container:
        found = np.concatenate([frame.to_ndarray().reshape(-1) for frame in container.decode(audio=0)])
    want = sound.samples(0.25, 0.5).reshape(-1)
    assert np.abs(want).max() > 0.05
    np.testing.assert_allclose(found / 32767, np.clip(want, -1, 1), atol=1e-4)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="needs the module bpy")
def test_blender_evaluates_the_points_of_every_frame(film: GaussianExport, tmp_path: Path) -> None:
    write_blend(tmp_path / "f.blend", film, 30)
    assert [entry.name for entry in tmp_path.iterdir()] == ["f.blend"]
    script = Path(__file__).with_name("blend_frames.py")
    files = [str(tmp_path / name) for name in ("f.blend", "f.npz")]
    subprocess.run(
        [sys.executable, "-P", str(script), *files], check=True, timeout=600
    )  # -P: not the modules beside it
    with np.load(tmp_path / "f.npz") as arrays:
        for frame, moment in enumerate(film.source):
            found = {name: arrays[f"{frame}/{name}"] for name in ("position", "rotation", "scale", "splat")}
            shows = found["splat"][:, 3] > 1 / 255
            points = turned(moment.at_degree(0), film.placement.turn)
            want = points[np.minimum(points.opacities, 0.9999) > 1 / 255]
            # Opacities near the limit may differ by their rounding.
            assert abs(shows.sum() - len(want)) <= 5
            want = points[points.opacities > 0.02]
            distance, nearest = KDTree(found["position"][shows]).query(want.means)
            assert distance.max() < 2e-4 * np.linalg.norm(np.ptp(points.means, axis=0))
            rows = np.flatnonzero(shows)[nearest]
            np.testing.assert_allclose(found["splat"][rows, 3], np.minimum(want.opacities, 0.9999), atol=0.012)
            light = np.maximum(want.base_colors, 0)
            linear = np.where(light <= 0.04045, light / 12.92, ((light + 0.055) / 1.055) ** 2.4)
            np.testing.assert_allclose(found["splat"][rows, :3], linear, atol=0.03)
            cosine = np.abs(np.sum(found["rotation"][rows] * want.quats, axis=1))
            assert cosine.min() > np.cos(0.02)
