""""""

import zipfile
from pathlib import Path

import pytest

from splatreel.base.errors import GaussiansError
from splatreel.formats.ply import write_ply
from splatreel.importing.frame_files import order_frames
from splatreel.importing.frames import open_frames
from tests.importing.films import frame, scene

MODEL = "point_cloud/iteration_40000/point_cloud.ply"


def write_model(root: Path, others: list[str], file: str = MODEL) -> Path:
    """Write a model's PLY file and empty other files. Return the PLY file."""
    for name in others:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"")
    (root / file).parent.mkdir(parents=True, exist_ok=True)
    write_ply(root / file, scene())
    return root / file


CASES = [
    (["point_cloud/iteration_40000/deformation.pth"], "4DGaussians .* or E-D3DGS .* export_perframe_3DGS"),
    (["deform/iteration_40000/deform.pth"], "Deformable-3D-Gaussians .* SC-GS and Grid4D"),
    (["deform/iteration_7000/deform.pth"], "Deformable-3D-Gaussians"),
    (["point_cloud/iteration_40000/posenet.pth"], "SplineGS"),
    (["point_cloud/iteration_40000/dynamic_point_cloud.ply"], "Ex4DGS"),
    (["NTC.pth"], "3DGStream"),
]


@pytest.mark.parametrize(("others", "said"), CASES)
def test_models_are_refused_by_method_however_they_are_named(tmp_path: Path, others: list[str], said: str) -> None:
    file = write_model(tmp_path / "out", others)
    for place in (tmp_path / "out", file.parent.parent, file.parent, file):
        with pytest.raises(GaussiansError, match=said) as caught:
            open_frames(place)
        assert str(tmp_path / "out" / others[0]) in str(caught.value)


@pytest.mark.parametrize(("others", "said"), [case for case in CASES if not case[0][0].endswith(".ply")])
@pytest.mark.parametrize("prefix", ["", "out/"])
def test_models_in_archives_are_refused(tmp_path: Path, others: list[str], said: str, prefix: str) -> None:
    file = write_model(tmp_path / "out", [])
    with zipfile.ZipFile(tmp_path / "film.zip", "w") as archive:
        archive.write(file, prefix + MODEL)
        for name in others:
            archive.writestr(prefix + name, b"")
    with pytest.raises(GaussiansError, match=said):
        open_frames(tmp_path / "film.zip")


def test_frames_of_3dgstream_are_refused(tmp_path: Path) -> None:
    """Each frame's folder holds the points that were added, and the network that moves the others."""
    for number in (1, 2):
        write_model(tmp_path / f"frame{number:06}", ["NTC.pth"], "point_cloud/iteration_250/added/point_cloud.ply")
    with pytest.raises(GaussiansError, match="3DGStream"):
        open_frames(tmp_path)


def test_frames_that_were_exported_into_a_training_folder_are_read(tmp_path: Path) -> None:
    write_model(tmp_path, ["deform/iteration_40000/deform.pth"])
    for number in range(2):
        (tmp_path / "frames").mkdir(exist_ok=True)
        write_ply(tmp_path / "frames" / f"time_{number:05}.ply", frame(number))
    assert len(open_frames(tmp_path / "frames")) == 2


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("chkpnt_best.pth", "4D Gaussian Splatting"),
        ("chkpnt30000.pth", "4D Gaussian Splatting"),
        ("checkpoints/last.ckpt", "Shape of Motion"),
        ("photometric_d_model_native_add3.pth", "MoSca"),
        ("splatfacto/2026-01-01/nerfstudio_models/step-000029999.ckpt", "4D-Rotor-Gaussians"),
    ],
)
@pytest.mark.parametrize("with_input", [False, True])
def test_checkpoints_without_files_of_gaussians_are_named(
    tmp_path: Path, name: str, said: str, with_input: bool
) -> None:
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_bytes(b"")
    if with_input:
        write_ply(tmp_path / "input.ply", scene())
    with pytest.raises(GaussiansError, match=said) as caught:
        open_frames(tmp_path)
    assert str(tmp_path / name) in str(caught.value)


@pytest.mark.parametrize(
    "names",
    [
        ["0", "1", "2"],
        ["f9", "f10", "f11"],
        ["frame_0001_splats", "frame_0002_splats"],
        ["v0.1_f3_final2", "v0.1_f4_final2"],
        ["12.0001", "12.0002", "12.0003"],
        ["shot.9", "shot.10"],
        ["f1/point_cloud/iteration_7", "f2/point_cloud/iteration_7"],
        ["0", "9" * 18],
        [f"{'7' * 5000}_1", f"{'7' * 5000}_2"],
        ["frame1_1700000033", "frame2_1700000067", "frame3_1700000100"],
    ],
)
def test_frames_are_ordered_by_the_number_that_differs(names: list[str]) -> None:
    order = order_frames(list(reversed(names)), "film", "refuse")
    assert (order.names, order.fps) == (names, None)
    assert order.step == (1 if "9" * 18 not in names else 10**18 - 1)


@pytest.mark.parametrize(
    ("names", "fps"),
    [
        (["0.000", "0.033", "0.067", "0.100"], 30),
        (["t9.5s", "t10.0s", "t10.5s"], 2),
        (["0.0", "0.25", "0.5", "0.75", "1.0"], 4),
        ([f"{frame / 24:.4f}" for frame in range(48)], 24),
        ([f"{frame * 1001 / 30000:.5f}" for frame in range(200)], 30000 / 1001),
    ],
)
def test_seconds_in_names_give_the_frame_rate(names: list[str], fps: float) -> None:
    order = order_frames(list(reversed(names)), "film", "refuse")
    assert order.names == names
    assert order.fps == pytest.approx(fps)


@pytest.mark.parametrize(("names", "step"), [(["f10", "f15", "f20"], 5), (["0", "33", "67", "100"], 100 / 3)])
def test_numbers_may_go_up_in_larger_steps(names: list[str], step: float) -> None:
    assert order_frames(names, "film", "refuse").step == pytest.approx(step)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["0", "1", "3"], "1 frame is missing, the first after 1: the next one is 3"),
        (["0.0", "0.1", "0.3"], "1 frame is missing, the first after 0.1: the next one is 0.3"),
        (["0", "33", "67", "133"], "1 frame is missing, the first after 67"),
        (["0.0", "0.1", "0.25"], "not evenly spaced: 0.1 and 0.25 are 0.15 s apart"),
        (["c1_f1", "c1_f2", "c2_f1"], "hold 2 numbers that differ between files"),
        (["a1", "a01"], "frame 1 twice"),
        (["a1", "b"], "the name b has no number"),
        (["a1", "a2", "b3"], "files called aN and files called bN"),
        (["f0", "f" + 20 * "9"], "the number 99999999999999999999 in a name has more than 18 digits"),
        (["f0", "f1", "f" + 5000 * "9"], "in a name has more than 18 digits, expected one that counts frames"),
        (["0.1", 400 * "9" + ".2"], "in a name has more than 18 digits"),
        (["f" + 5000 * "9", "f0" + 5000 * "9"], "frame 9999999999999999999999999999999999999999 twice"),
    ],
)
def test_unclear_orders_and_gaps_are_named(names: list[str], said: str) -> None:
    with pytest.raises(GaussiansError) as caught:
        order_frames(names, "film", "refuse")
    assert str(caught.value).startswith("film: ")
    assert said in str(caught.value)


def test_held_frames_repeat_names() -> None:
    assert order_frames(["0.0", "0.1", "0.3"], "film", "hold").names == ["0.0", "0.1", "0.1", "0.3"]
