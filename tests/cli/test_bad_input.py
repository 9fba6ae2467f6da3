"""Command-line errors for captures and folders that cannot be used: one block that names the file and the remedy."""

import json
import os
import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from splatreel.capture.opening import open_capture
from splatreel.cli.main import main
from tests.capture import folders


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a capture of five cameras and three frames, with cam00 held out."""
    return folders.neu3dv(tmp_path_factory.mktemp("made") / "scene", count=5, frames=3)


@pytest.fixture
def scene(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(made, "scene")
    return Path("scene")


def change_poses(scene: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    np.save(scene / "poses_bounds.npy", change(np.load(scene / "poses_bounds.npy")))


def cut(file: Path, share: float) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])


def with_nan(poses: np.ndarray) -> np.ndarray:
    poses[3, 7] = np.nan
    return poses


def gathered(poses: np.ndarray) -> np.ndarray:
    poses[:, [3, 8, 13]] = 1.0
    return poses


def lost(poses: np.ndarray) -> np.ndarray:
    poses[2, 3] = 1e9
    return poses


def remove_cameras(scene: Path, left: int) -> None:
    for number in range(left, 5):
        (scene / f"cam{number:02d}.mp4").unlink()
    change_poses(scene, lambda p: p[:left])


def longer(scene: Path) -> None:
    folders.write_video(scene / "cam03.mp4", [folders.frame(3, t) for t in range(5)])


def cut_film(scene: Path) -> None:
    """A video that begins with its table of contents, so that the frames that are gone are known."""
    film = [folders.frame(2, t) for t in range(12)]
    folders.write_video(scene / "cam02.mp4", film, {"movflags": "faststart"})
    cut(scene / "cam02.mp4", 0.8)


def jumped(scene: Path) -> None:
    """Delay the third frame by five frames."""
    with av.open(str(scene / "cam02.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.height, stream.width, stream.pix_fmt = folders.HEIGHT, folders.WIDTH, "yuv444p"
        for number, time in enumerate((0, 1, 7)):
            image = av.VideoFrame.from_ndarray(folders.frame(2, number), format="rgb24")
            image.pts, image.time_base = time, Fraction(1, 30)
            container.mux(stream.encode(image))
        container.mux(stream.encode(None))


def two_arrays(scene: Path) -> None:
    np.savez(scene / "a.npz", np.zeros(3), np.ones(3))
    (scene / "a.npz").replace(scene / "poses_bounds.npy")


SPOILED: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "a missing camera": (
        lambda s: (s / "cam03.mp4").unlink(),
        ["scene: 4 videos", "5 rows in poses_bounds.npy", "add the missing"],
    ),
    "an extra camera": (
        lambda s: shutil.copy(s / "cam03.mp4", s / "cam09.mp4"),
        ["scene: 6 videos", "5 rows", "--leave-out"],
    ),
    "unequal frame counts": (longer, ["cam00.mp4 has 3", "cam03.mp4 has 5", "--frames 0:3"]),
    "a truncated video": (cut_film, ["scene/cam02.mp4: is truncated", "of 12 frames", "Copy the file again"]),
    "half a video": (lambda s: cut(s / "cam02.mp4", 0.6), ["scene/cam02.mp4", "truncated", "copy it again"]),
    "an empty video": (lambda s: cut(s / "cam02.mp4", 0), ["scene/cam02.mp4", "copy it again"]),
    "poses of the wrong shape": (
        lambda s: change_poses(s, lambda p: p[:, :15]),
        ["scene/poses_bounds.npy", "(5, 15)", "[cameras, 17]", "imgs2poses"],
    ),
    "NaN poses": (lambda s: change_poses(s, with_nan), ["scene/poses_bounds.npy", "row 3", "NaN", "remove the row"]),
    "poses that are no array": (lambda s: cut(s / "poses_bounds.npy", 0.01), ["scene/poses_bounds.npy", "Copy it"]),
    "objects in place of poses": (
        lambda s: np.save(s / "poses_bounds.npy", np.array([{}, None], object), allow_pickle=True),
        ["scene/poses_bounds.npy: is of object, expected an array of plain numbers"],
    ),
    "a pipe": (
        lambda s: os.mkfifo(s / "cam09.mp4"),
        ["scene/cam09.mp4: is neither a file nor a folder", "Remove it from the capture"],
    ),
    "poses in an archive": (two_arrays, ["scene/poses_bounds.npy", "an archive of several arrays"]),
    "cameras in one place": (
        lambda s: change_poses(s, gathered),
        ["scene: all 5 cameras", "have the same position", "poses"],
    ),
    "a camera far off": (
        lambda s: change_poses(s, lost),
        ["scene: camera 'cam02' stands 1e+09", "leave the camera out"],
    ),
    "two cameras": (lambda s: remove_cameras(s, 2), ["scene: 2 cameras (cam00, cam01)", "at least 3"]),
    "two cameras to train on": (lambda s: remove_cameras(s, 3), ["scene: only 2 cameras", "held-out cam00", "3"]),
    "near and far exchanged": (
        lambda s: change_poses(s, lambda p: p[:, [*range(15), 16, 15]]),
        ["scene/poses_bounds.npy: row 0", "near bound 9", "far bound 1.5", "exchange them"],
    ),
    "a jump of five frames": (
        jumped,
        [
            "cam00.mp4 has 3",
            "cam02.mp4 has 3 frames, which span 8 time steps",
            "--frames 0:3",
            "capture sync",
        ],
    ),
    "mirrored poses": (
        lambda s: change_poses(s, lambda p: p * np.array([1, -1, 1, 1, 1] * 3 + [1, 1])),
        ["scene/poses_bounds.npy: the row of cam00:", "it mirrors", "x right, y down, z forward"],
    ),
    "an endless frame rate": (
        lambda s: (s / "splatreel.json").write_text('{"fps": 1e999}'),
        ["scene/splatreel.json: fps is inf", "Correct it or remove it"],
    ),
}


@pytest.mark.parametrize("what", SPOILED)
def test_captures_that_cannot_be_used(what: str, scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spoil, expected = SPOILED[what]
    spoil(scene)
    assert main(["reconstruct", "scene", "--out", "out"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("Error: ")
    assert [part for part in expected if part not in error] == []
    assert not Path("out").exists()
    assert main(["capture", "check", "scene"]) == 1
    assert error == "".join(line for line in capsys.readouterr().err.splitlines(True) if line.startswith("Error: "))


def test_video_with_a_jump_is_used_up_to_the_jump(scene: Path) -> None:
    jumped(scene)
    assert open_capture(scene, frames=(0, 2)).read(0, 2, ["cam02"]).shape[0] == 2
    (scene / "splatreel.json").write_text(json.dumps({"starts": {"cam02": 0.0}}))
    frames = open_capture(scene, frames=(0, 3)).read(0, 3, ["cam02"])[:, 0]
    assert [folders.which(frame) for frame in frames] == [(2, 0), (2, 1), (2, 1)]  # the nearest in time


def test_black_videos_are_refused_by_both(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders.write_video(scene / "cam03.mp4", [np.zeros((folders.HEIGHT, folders.WIDTH, 3), np.uint8)] * 3)
    for command in (["reconstruct", "scene", "--out", "out"], ["capture", "check", "scene"]):
        assert main(command) == 1
        assert "Error: scene: all images of camera cam03 are black. Choose other frames" in capsys.readouterr().err
    assert not Path("out/work/run.json").exists()


def test_check_accepts_the_captures_that_reconstruction_accepts(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    remove_cameras(scene, 3)
    assert main(["capture", "check", "scene"]) == 1
    assert "only 2 cameras are left to train on" in capsys.readouterr().err
    assert main(["capture", "check", "scene", "--hold-out", "none"]) == 1
    said, error = capsys.readouterr()
    assert "show too little in common to check their poses" in said
    assert "will not be usable" in said
    assert "Error: scene: Do not reconstruct it as it is:\n  - the images do not confirm the poses" in error
    assert error.endswith("To try anyway, run\n  splatreel reconstruct scene --out OUT --hold-out none\n")


ASKED = {
    "--frames 0:9": ["scene: frames 0:9", "0 <= first < end <= 3"],
    "--frames 3:4": ["scene: frames 3:4", "frames 0:3"],
    "--width 4": ["scene: images of 4x3 pixels", "at least 8", "larger width or scale"],
    "--width 0": ["scene", "0 pixels wide", "1 to 16384"],
    "--width=-5": ["scene", "-5 pixels wide", "1 to 16384"],
    "--width 1000000": ["scene", "1000000 pixels wide"],
    f"--frames 0:{'9' * 5000}": ["--frames '0:999", "is not a range of frames"],
    "--scale nan": ["scene", "nan", "positive"],
    "--scale 1e9": ["scene", "more than 16384 pixels"],
    "--width 16 --scale 0.5": ["scene", "give one of them"],
    "--hold-out cam00,cam01,cam02": ["scene: only 2 cameras", "cam00, cam01, cam02", "at least 3", "Hold out fewer"],
    "--hold-out cam77": ["scene", "no camera 'cam77'", "cam00, cam01"],
    "--seed -1": ["--seed -1", "from 0 to 4294967295"],
    "--seed 99999999999": ["--seed 99999999999", "from 0 to 4294967295"],
}


@pytest.mark.parametrize("options", ASKED)
def test_options_that_do_not_fit_the_capture(options: str, scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = options.replace("--seed -1", "--seed=-1").split()
    assert main(["reconstruct", "scene", "--out", "out", *words]) in (1, 2)
    error = capsys.readouterr().err
    assert error.startswith("Error: ")
    assert [part for part in ASKED[options] if part not in error] == []
    assert not Path("out").exists()


def test_damaged_image_stops_the_run_without_claiming_the_folder(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its packets are all there, so that only decoding finds it; a repaired copy may be another size."""
    file = scene / "cam02.mp4"
    data = bytearray(file.read_bytes())
    start = data.index(b"mdat") + 4
    data[start + 700 : start + 1500] = bytes(800)
    file.write_bytes(data)
    assert main(["reconstruct", "scene", "--out", "out"]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("Error: scene/cam02.mp4")
    assert "opy" in error
    assert not Path("out/work/run.json").exists()


def test_folder_of_another_run_is_refused_and_kept(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    work = Path("out/work")
    work.mkdir(parents=True)
    (work / "run.json").write_text(json.dumps({"version": 1, "capture": {"frames": "0:300"}, "config": {}}))
    assert main(["reconstruct", "scene", "--out", "out"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("Error: out/work/run.json: this folder holds another reconstruction")
    assert "Choose another --out" in error
    assert json.loads((work / "run.json").read_text())["capture"] == {"frames": "0:300"}


def test_output_folder_that_is_a_file(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("out").write_text("mine")
    assert main(["reconstruct", "scene", "--out", "out"]) == 1
    assert capsys.readouterr().err.startswith("Error: out/work: cannot be written")
    assert Path("out").read_text() == "mine"
