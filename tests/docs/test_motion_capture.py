"""The commands of docs/motion-capture.md, from the demo's folder to the film, at a small size."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from splatreel.cli.main import main
from splatreel.scene.camera import Camera, facing, unproject
from tests.capture.folders import write_video

cv2 = pytest.importorskip("cv2")
PAGE = Path(__file__).parent.parent.parent / "docs" / "motion-capture.md"
WIDTH, HEIGHT, FRAMES = 128, 96, 12
BODY = (
    ((0.0, 0.3, 0.0), 0.22, (200, 50, 40)),
    ((0.0, 0.75, 0.0), 0.26, (40, 60, 200)),
    ((0.0, 1.2, 0.0), 0.2, (230, 190, 150)),
    ((0.3, 0.8, 0.1), 0.12, (60, 180, 60)),
)
"""Middles, radii and colors of the balls of a person on a floor at height 0, in meters. Up is y."""
WHERE = "Pose2Sim/Demo_SinglePerson"
REPLACED = {"0:60": f"0:{FRAMES}", "640": "96"}
FEW = "keyframe.first_iterations=80 keyframe.refine_iterations=15 group.length=6 group.iterations_per_frame=4"
MORE = {
    "reconstruct": ["--quality=draft", "--device=cpu", *(f"--set={setting}" for setting in FEW.split())],
    "export": ["--width=96", "--frames=0:4"],
}
"""Arguments that make the commands of the page quick."""


def rig() -> list[Camera]:
    """Return four cameras, 70 to 110 degrees apart."""
    views = []
    for number, degrees in enumerate((0, 80, 185, 280)):
        angle = np.radians(degrees)
        center = np.array([4 * np.sin(angle), 1.6 + 0.2 * (number % 2), 4 * np.cos(angle)])
        forward = np.array([0, 0.6, 0]) - center
        name = f"cam0{number + 1}"
        views.append(facing(name, center, forward / np.linalg.norm(forward), 0.9 * WIDTH, WIDTH, HEIGHT))
    return views


def film(view: Camera, frames: int) -> list[np.ndarray]:
    """Return images [H, W, 3] uint8 of a person who walks over a floor with a pattern, before gray walls."""
    rays = unproject(view, np.ones((view.height, view.width))) - view.center
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    down = np.where(rays[..., 1] < -1e-3, -view.center[1] / np.minimum(rays[..., 1], -1e-3), np.inf)
    places = view.center + np.where(np.isfinite(down), down, 0)[..., None] * rays
    pattern = np.random.default_rng(0).uniform(70, 190, (40, 40, 3))
    tile = np.clip(((places[..., [0, 2]] + 5) * 4).astype(int), 0, 39)
    room = np.where((down < 7)[..., None], pattern[tile[..., 0], tile[..., 1]], 120 + 30 * rays[..., [0]])
    images = []
    for frame in range(frames):
        walk = np.array([0.8 * np.sin(0.5 * frame), 0, 0.5 * np.cos(0.5 * frame)])
        image, depth = room.copy(), np.full(down.shape, np.inf)
        for middle, radius, color in BODY:
            to_middle = np.array(middle) + walk - view.center
            along = rays @ to_middle
            beside = np.linalg.norm(to_middle - along[..., None] * rays, axis=-1)
            shown = (beside < radius) & (along < depth)
            depth[shown] = along[shown]
            image[shown] = color
        images.append(image.clip(0, 255).astype(np.uint8))
    return images


def write_demo(folder: Path, frames: int = FRAMES) -> None:
    """Write the films and their calibration as Pose2Sim's demo has them."""
    (folder / "videos").mkdir(parents=True)
    (folder / "calibration").mkdir()
    tables = []
    for view in rig():
        write_video(folder / "videos" / f"{view.name}.mp4", film(view, frames))
        K = view.K.astype(float) - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]  # cv2's pixel centers
        turn = cv2.Rodrigues(view.viewmat[:3, :3].astype(float))[0].ravel().tolist()
        tables.append(
            f'[{view.name}]\nname = "{view.name}"\nsize = [ {WIDTH}.0, {HEIGHT}.0]\nmatrix = {K.tolist()}\n'
            f"distortions = [ 0.0, 0.0, 0.0, 0.0]\nrotation = {turn}\ntranslation = {view.viewmat[:3, 3].tolist()}\n"
            "fisheye = false\n"
        )
    (folder / "calibration" / "Calib_scene.toml").write_text("\n".join(tables) + "[metadata]\nadjusted = false\n")
    (folder / "Config.toml").write_text("[project]\nmulti_person = false\n")


def commands() -> list[list[str]]:
    """Return the arguments of `splatreel` in the commands of the page, in order."""
    lines = re.findall(r"^    splatreel (.+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return [[REPLACED.get(part, part) for part in shlex.split(line)] for line in lines]


@pytest.mark.slow
def test_the_page_is_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    write_demo(Path(WHERE))
    asked = commands()
    verbs = [" ".join(command[: 1 + (command[0] == "capture")]) for command in asked]
    assert verbs == [
        "capture check",
        "capture masks",
        "capture check",
        "reconstruct",
        "edit",
        "serve",
        "export",
        "publish",
    ]
    said = {}
    for number, (verb, command) in enumerate(zip(verbs, asked, strict=True)):
        if verb not in ("serve", "publish"):
            assert main([*command, *MORE.get(verb, [])]) == 0, (command, capsys.readouterr())
            said[number] = capsys.readouterr().out
    assert "the poses cannot be confirmed by images this far apart" in said[0]
    assert f"splatreel capture masks {WHERE} --out masks" in said[0]
    assert "the poses are confirmed by the masks" in said[2]
    assert "It can be reconstructed" in said[2]
    assert Path("check.html").stat().st_size > 10_000
    assert Path("film.mp4").stat().st_size > 1_000
