"""Training folders of dynamic methods: their PLY file is not a frame, because other files move its points."""

import zipfile
from pathlib import Path

import pytest

from splatreel.base.errors import GaussiansError
from splatreel.formats.ply import write_ply
from splatreel.importing.recognition import open_frames
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
