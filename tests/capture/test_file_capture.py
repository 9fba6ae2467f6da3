"""Every reader checks the shape of every image of every camera."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.capture.color import BT2020
from splatreel.capture.opening import open_capture
from splatreel.capture.video import VideoFile
from tests.capture import folders
from tests.capture.colors import COLORS, SIDE, squares, write_colors, write_display_matrix
from tests.capture.recorder import Recorder

LAYOUTS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "panoptic": (folders.panoptic, "ims/2/00000{}.png"),
    "technicolor": (lambda path: folders.technicolor(path, first=0), "Painter_undist_0000{}_02.png"),
    "easyvolcap": (folders.easyvolcap, "images/02/00000{}.png"),
}
"""Writers of layouts with images, and an image of a camera by time step."""


def stretch(image: Path) -> None:
    """Make an image square."""
    with Image.open(image) as opened:
        squeezed = opened.convert("RGB").resize((24, 24))
    squeezed.save(image)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("frame", [0, 1])
def test_image_of_another_shape_is_refused(tmp_path: Path, layout: str, frame: int) -> None:
    pytest.importorskip("pycolmap")
    write, name = LAYOUTS[layout]
    scene = write(tmp_path / "scene")
    stretch(scene / name.format(frame))
    with pytest.raises(CaptureError, match=r"24x24|for 64x48|different sizes"):
        open_capture(scene).read(0, 2, [camera.name for camera in open_capture(scene).cameras])


def test_colmap_image_of_another_shape_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = folders.colmap(tmp_path / "scene")
    stretch(scene / "images_2" / "view" / "cam02.jpg")
    with pytest.raises(CaptureError, match=r"camera view/cam02 is calibrated for 64x48, but its images are 24x24"):
        open_capture(scene)


def test_colmap_images_are_read_as_stored(tmp_path: Path) -> None:
    """COLMAP ignores EXIF, and 3DGS does, so that its cameras belong to the stored images."""
    pytest.importorskip("pycolmap")
    scene = folders.colmap(tmp_path / "scene")
    plain = open_capture(scene).read(0, 1, ["view/cam02"])
    for number in (3, 6):
        with Image.open(scene / "images_2" / "view" / "cam02.jpg") as opened:
            opened.getexif()[0x112] = number
            opened.save(scene / "images_2" / "view" / "cam02.jpg", quality="keep", exif=opened.getexif())
        capture = open_capture(scene)
        np.testing.assert_array_equal(capture.read(0, 1, ["view/cam02"]), plain)
        assert capture.notes == ["view/cam02: images are not turned as EXIF says, as in COLMAP"]


def write_changing_video(path: Path, sizes: list[tuple[int, int]]) -> None:
    """Write MPEG-TS whose images change their size, one image for each size."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = *sizes[0], "yuv420p"
        for number, (width, height) in enumerate(sizes):
            encoder: Any = av.CodecContext.create("libx264", "w")
            encoder.width, encoder.height, encoder.pix_fmt, encoder.time_base = (
                width,
                height,
                "yuv420p",
                Fraction(1, 30),
            )
            image = av.VideoFrame.from_ndarray(folders.frame(1, number, width, height), format="rgb24")
            for packet in [*encoder.encode(image), *encoder.encode(None)]:
                packet.pts = packet.dts = 3000 * number
                packet.stream, packet.time_base = stream, Fraction(1, 90000)
                container.mux(packet)


def test_video_whose_size_changes_is_refused(tmp_path: Path) -> None:
    write_changing_video(tmp_path / "cam01.ts", [(32, 24)] * 3 + [(48, 24)] * 3)
    video = VideoFile(tmp_path / "cam01.ts")
    out = np.empty((6, 24, 32, 3), np.uint8)
    video.read_into(out[:3], np.arange(3))
    assert [folders.which(image) for image in out[:3]] == [(1, 0), (1, 1), (1, 2)]
    with pytest.raises(CaptureError, match=r"cam01\.ts: frame 3 is 48x24, frame 0 is 32x24"):
        video.read_into(out, np.arange(6))


def test_segment_of_another_size_is_refused(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "scene", "segments")
    recorder.write(12)
    recorder.end()
    file = tmp_path / "scene" / "cam01" / "000001.mp4"
    assert file.exists()
    folders.write_video(file, [folders.frame(1, t, 48, 24) for t in range(4)])
    with pytest.raises(CaptureError, match=r"000001\.mp4: is 48x24, \d+\.mp4 is 32x24"):
        open_capture(tmp_path / "scene").read(0, 9, ["cam01"])


def test_calibration_of_the_stored_orientation_is_named(tmp_path: Path) -> None:
    scene = folders.neu3dv(tmp_path / "scene")
    write_display_matrix(scene / "cam01.mp4", (0, 1, -1, 0))
    with pytest.raises(
        CaptureError, match=r"camera cam01 is calibrated for 32x24, but its images are 24x32, turned by a"
    ):
        open_capture(scene, width=32)


def test_principal_point_of_another_size_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = folders.easyvolcap(tmp_path / "scene")
    text = (scene / "intri.yml").read_text()
    for key in ("W_", "H_"):
        text = text.replace(key, f"not_{key}")
    (scene / "intri.yml").write_text(text)
    with pytest.raises(
        CaptureError, match=r"K_00 has the principal point 32, 24, .* 32x24: it is for images of another"
    ):
        open_capture(scene)
    parameters = folders.technicolor(tmp_path / "light field") / "cameras_parameters.txt"
    parameters.write_text(parameters.read_text().replace("16.0 12.0", "1024.0 544.0"))
    with pytest.raises(CaptureError, match=r"camera 00 has the principal point 1024, 544"):
        open_capture(parameters.parent)


def test_sidecar_declares_the_transfer_function(tmp_path: Path) -> None:
    scene = folders.neu3dv(tmp_path / "scene")
    poses = np.load(scene / "poses_bounds.npy")
    poses[:, [4, 9]] = SIDE, len(COLORS) * SIDE
    np.save(scene / "poses_bounds.npy", poses)
    for file in sorted(scene.glob("*.mp4")):
        write_colors(file, COLORS / 255, (BT2020, 2, 2), bits=10)
    with pytest.raises(CaptureError, match=r'cam00\.mp4: declares BT\.2020 .* Write "transfer": "hlg"'):
        open_capture(scene)
    (scene / "splatreel.json").write_text('{"transfer": "hlg"}')
    capture = open_capture(scene)
    assert capture.notes == [
        f"all cameras: {phrase}" for phrase in VideoFile(scene / "cam00.mp4", transfer="hlg").color.conversions(SIDE)
    ]
    assert squares(capture.read(0, 1, ["cam02"])[0, 0])[3].tolist() == [255] * 3
