import re
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import blobs

pytest.importorskip("pycolmap")

FRAME = {
    "f": 150.0,
    "cx": 3.2,
    "cy": -2.1,
    "k1": -0.2,
    "k2": 0.06,
    "k3": 0.01,
    "p1": 0.006,
    "p2": -0.004,
    "b1": 2.5,
    "b2": 1.5,
    "k4": 0.3,
}
PLAIN = {key: value for key, value in FRAME.items() if key not in ("b2", "k4")}
FISHEYE = {"f": 130.0, "cx": 3.2, "cy": -2.1, "k1": 0.05, "k2": -0.01, "k3": 0.002, "k4": -0.001, "b1": 2.0}


def project(c: int, lens: dict[str, float], fisheye: bool = False) -> np.ndarray:
    """Project as the appendix "Camera models" of the manual says; the center of the first pixel is at (0.5, 0.5)."""
    value = dict.fromkeys(("k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2"), 0.0) | lens
    R, t = blobs.poses()[c]
    X, Y, Z = R @ blobs.POINTS.T + t[:, None]
    x, y = X / Z, Y / Z
    if fisheye:
        r0 = np.hypot(x, y)
        x, y = x * np.arctan(r0) / r0, y * np.arctan(r0) / r0
    r = np.hypot(x, y)
    radial = 1 + value["k1"] * r**2 + value["k2"] * r**4 + value["k3"] * r**6 + value["k4"] * r**8
    x_bent = x * radial + value["p1"] * (r**2 + 2 * x**2) + 2 * value["p2"] * x * y
    y_bent = y * radial + value["p2"] * (r**2 + 2 * y**2) + 2 * value["p1"] * x * y
    u = blobs.WIDTH * 0.5 + value["cx"] + x_bent * value["f"] + x_bent * value["b1"] + y_bent * value["b2"]
    v = blobs.HEIGHT * 0.5 + value["cy"] + y_bent * value["f"]
    return np.stack([u, v], 1)


def write(folder: Path, lens: dict[str, float], kind: str = "frame", component: str = 'component_id="0"') -> Path:
    cameras = []
    for c, (R, t) in enumerate(blobs.poses()):
        world = np.eye(4)
        world[:3, :3], world[:3, 3] = R.T, -R.T @ t
        numbers = " ".join(str(value) for value in world.ravel())
        inside = f'<camera id="{c}" sensor_id="0" {component if c else ""} label="cam{c}.JPG"><transform>{numbers}</transform></camera>'
        cameras.append(f"<group>{inside}</group>" if c == 3 else inside)
    values = "".join(f"<{key}>{value}</{key}>" for key, value in lens.items())
    (folder / "cameras.xml").write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0"><chunk label="Chunk 1" enabled="1">'
        f'<sensors next_id="1"><sensor id="0" label="unknown" type="{kind}"><resolution width="160" height="120"/>'
        f'<calibration type="{kind}" class="initial"><resolution width="160" height="120"/><f>99</f></calibration>'
        f'<calibration type="{kind}" class="adjusted"><resolution width="160" height="120"/>{values}</calibration>'
        f'</sensor></sensors><cameras>{"".join(cameras)}<camera id="9" sensor_id="0" label="lost.JPG"/></cameras>'
        f"<transform><rotation>1 0 0 0 1 0 0 0 1</rotation><scale>7</scale></transform></chunk></document>"
    )
    fisheye = kind == "fisheye"
    blobs.write(folder / "images", [f"cam{c}" for c in range(4)], lambda c: project(c, lens, fisheye), first=0.5)
    return folder


@pytest.mark.parametrize("lens", [FRAME, PLAIN], ids=["k4 and skew", "OpenCV's"])
def test_frame_cameras(tmp_path: Path, lens: dict[str, float]) -> None:
    capture = open_capture(write(tmp_path, lens, component=""))
    assert ([c.name for c in capture.cameras], capture.layout) == ([f"cam{c}.JPG" for c in range(4)], "Metashape")
    assert blobs.errors(capture).max() < 0.1
    assert "not aligned, and left out: lost.JPG" in capture.notes[0]


def test_fisheye_cameras(tmp_path: Path) -> None:
    assert blobs.errors(open_capture(write(tmp_path, FISHEYE, "fisheye", ""))).max() < 0.1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<f>150.0</f>", "", r"sensor unknown: is frame with f 0.*fix these at 0"),
        ("<k1>", "<p3>0.1</p3><k1>", r"p3 0\.1 and p4 0"),
        ('"frame"', '"spherical"', r"sensor unknown: is spherical"),
        ("<k1>-0.2<", "<k1>much<", r"sensor unknown: cannot be read"),
        ('sensor_id="0" component', 'sensor_id="7" component', r"camera cam1\.JPG: has no sensor"),
        (
            "</transform></camera>",
            "</transform><orientation>3</orientation></camera>",
            r"turned by the EXIF orientation 3",
        ),
        ("</chunk>", "</chunk><chunk/>", r"cameras\.xml: holds 2 chunks"),
    ],
)
def test_unusable_files_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    file = write(tmp_path, PLAIN) / "cameras.xml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new).replace('component_id="0"', ""))
    with pytest.raises(CaptureError, match=message):
        open_capture(tmp_path)


def test_components_have_no_common_place(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="were aligned in 2 components"):
        open_capture(write(tmp_path, PLAIN, component='component_id="1"'))


def rig(folder: Path, drop: str = "") -> Path:
    """Write a multi-camera system: camera 0 has a pose, and the sensors of the others have a place in its axes."""
    world = []
    for R, t in blobs.poses():
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = R.T, -R.T @ t
        world.append(matrix)
    values = "".join(f"<{key}>{value}</{key}>" for key, value in PLAIN.items())
    sensors, cameras = "", ""
    for c, matrix in enumerate(world):
        offset = np.linalg.inv(world[0]) @ matrix
        turn, place = (" ".join(map(str, part.ravel())) for part in (offset[:3, :3], offset[:3, 3]))
        slave = f"<rotation>{turn}</rotation><location>{place}</location>" if c else ""
        sensors += (
            f'<sensor id="{c}" label="unknown" type="frame" master_id="0"><resolution width="160" height="120"/>'
            f'<calibration type="frame" class="adjusted"><resolution width="160" height="120"/>{values}</calibration>{slave}</sensor>'
        )
        pose = f"<transform>{' '.join(map(str, matrix.ravel()))}</transform>" if c == 0 else ""
        part = 'component_id="0"' if c == 0 else 'master_id="0"'
        cameras += f'<camera id="{c}" sensor_id="{c}" {part} label="cam{c}">{pose}</camera>'
    text = (
        f'<document version="2.0.0"><chunk label="Chunk 1"><sensors>{sensors}</sensors><cameras>{cameras}'
        f'<camera id="8" sensor_id="0" label="lost"/><camera id="9" sensor_id="1" master_id="8" label="slave of lost"/></cameras>'
        f"</chunk></document>"
    )
    (folder / "cameras.xml").write_text(re.sub(drop, "", text) if drop else text)
    blobs.write(folder / "images", [f"cam{c}" for c in range(4)], lambda c: project(c, PLAIN), first=0.5)
    return folder


def test_multi_camera_systems(tmp_path: Path) -> None:
    capture = open_capture(rig(tmp_path))
    assert [c.name for c in capture.cameras] == [f"cam{c}" for c in range(4)]
    assert blobs.errors(capture).max() < 0.1
    assert "not aligned, and left out: lost, slave of lost" in capture.notes[0]


def test_slaves_without_a_place_are_named(tmp_path: Path) -> None:
    with pytest.raises(
        CaptureError, match=r"of camera cam1: belongs to a multi-camera system, but has no rotation and"
    ):
        open_capture(rig(tmp_path, r"<location>[^<]*</location>"))


def test_a_damaged_place_is_named(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match=r"of camera cam1: cannot be read"):
        open_capture(rig(tmp_path, r"(?<=<location>)[^<]*"))
