from pathlib import Path

import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.readers.calibrations.media import find_media


def touch(path: Path, *files: str) -> Path:
    for file in files:
        (path / file).parent.mkdir(parents=True, exist_ok=True)
        (path / file).touch()
    return path


def found(path: Path, names: list[str], partial: bool = False) -> list[str]:
    """Return the file or the first image of each camera, relative to the capture."""
    media = find_media(path, names, path / "rig.toml", partial)
    return [
        (file if isinstance(file, Path) else file[0]).relative_to(path).as_posix()
        for file in (media[name] for name in names if name in media)
    ]


@pytest.mark.parametrize(
    ("names", "files"),
    [
        (["cam1", "cam2", "cam10"], ["cam1.mp4", "cam2.mp4", "cam10.mp4"]),
        (["cam01", "cam02", "cam10"], ["videos/Cam1.MP4", "videos/Cam2.MP4", "videos/Cam10.MP4"]),
        (["cam_0", "cam_1", "cam_2"], [f"synchronized_videos/Camera_00{c}_synchronized.mp4" for c in range(3)]),
        (["A", "B", "C"], [f"videos-raw/2024-01-02-vid3-cam{c}.avi" for c in "ABC"]),
        (["00_05", "00_06", "00_07"], [f"hdVideos/hd_00_0{c}.mp4" for c in (5, 6, 7)]),
        (["IMG_1.JPG", "IMG_2.JPG"], ["images/IMG_1.png", "images/IMG_2.png"]),
        (["left", "right", "top"], [f"images/{name}/000000.jpg" for name in ("left", "right", "top")]),
        (["cam_0", "cam_1"], [f"recordings/recording_1/port_{c}.mp4" for c in range(2)]),
    ],
)
def test_names_that_mean_the_same_are_paired(tmp_path: Path, names: list[str], files: list[str]) -> None:
    assert found(touch(tmp_path, *files), names) == files


def test_equal_names_win_over_similar_ones(tmp_path: Path) -> None:
    """Takes are numbered as the cameras are."""
    files = [f"take_1/cam_{c}.mp4" for c in range(1, 4)]
    touch(tmp_path, *files, *(f"take_{t}/other.mp4" for t in (2, 3)))
    assert found(tmp_path, ["cam_1", "cam_2", "cam_3"]) == files


def test_preferred_folders_are_read(tmp_path: Path) -> None:
    names = ["a", "b", "c"]
    for folder in ("annotated_videos", "calibration/extrinsic", "videos", "synchronized_videos", "images/a"):
        touch(tmp_path, *(f"{folder}/{name}.mp4" for name in names))
    assert found(tmp_path, names) == [f"synchronized_videos/{name}.mp4" for name in names]


def test_several_recordings_are_ambiguous(tmp_path: Path) -> None:
    for take in (1, 2, 3):
        touch(tmp_path, *(f"recordings/recording_{take}/cam_{c}.mp4" for c in (1, 2, 3)))
    with pytest.raises(
        CaptureError,
        match=r"recording_1, recordings/recording_2, .*Give the one to read, such as .*recordings/recording_1\.",
    ):
        found(tmp_path, ["cam_1", "cam_2", "cam_3"])


def test_copies_of_a_recording_are_no_recordings(tmp_path: Path) -> None:
    """Trackers write annotated videos below a recording, or beside its videos."""
    names = ["cam_0", "cam_1", "cam_2"]
    for folder in ("walk", "walk/HOLISTIC", "calibration/extrinsic", "S00_Calibration/intrinsics"):
        touch(tmp_path / "one" / folder, *(f"{name}.mp4" for name in names))
    assert found(tmp_path / "one", names) == [f"walk/{name}.mp4" for name in names]
    for folder in ("Trial_1/videos", "Trial_1/pose", "Trial_1/videos_raw"):
        touch(tmp_path / "two" / "P00" / folder, *(f"{name}_a.mp4" for name in names))
    assert found(tmp_path / "two", names) == [f"P00/Trial_1/videos/{name}_a.mp4" for name in names]
    touch(tmp_path / "two" / "Trial_2" / "videos", *(f"{name}.avi" for name in names))
    touch(tmp_path / "two" / "Trial_3" / "videos", *(f"{name}.avi" for name in names))
    with pytest.raises(
        CaptureError, match=r"in rig\.toml: Trial_2, Trial_3\. Give the one to read, such as .*/Trial_2\."
    ):
        found(tmp_path / "two", names)


def test_videos_of_the_calibration_are_read_if_there_are_no_others(tmp_path: Path) -> None:
    names = ["cam_0", "cam_1", "cam_2"]
    touch(tmp_path, *(f"calibration/{kind}/{name}.mp4" for kind in ("extrinsic", "intrinsic") for name in names))
    assert found(tmp_path, names) == [f"calibration/extrinsic/{name}.mp4" for name in names]


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ([], r"holds no videos or images of the cameras cam_0, cam_1, cam_2 in rig\.toml"),
        (
            ["videos/cam_0.mp4", "videos/cam_1.mp4", "videos/cam_2b.mp4"],
            r"to 1 of the 3 .*first is 'cam_2'.*Is it 'cam_2b'\?",
        ),
        ([f"cam_{c}.mp4" for c in (1, 2, 3)], r"in \. belong to 1 of the 3 cameras in rig\.toml, the first is 'cam_0'"),
        (["cam_0.mp4", "cam_0.webm", "cam_1.mp4", "cam_2.mp4"], r"there are cam_0\.mp4, cam_0\.webm, cam_1, cam_2"),
    ],
)
def test_missing_media_are_named(tmp_path: Path, files: list[str], message: str) -> None:
    with pytest.raises(CaptureError, match=message):
        found(touch(tmp_path, *files), ["cam_0", "cam_1", "cam_2"])


def test_some_formats_have_more_cameras_than_videos(tmp_path: Path) -> None:
    touch(tmp_path, "cam_1.mp4", "cam_2.mp4")
    assert found(tmp_path, ["cam_0", "cam_1", "cam_2"], partial=True) == ["cam_1.mp4", "cam_2.mp4"]
