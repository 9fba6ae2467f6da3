import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import blobs

pytest.importorskip("pycolmap")

F35, OFFSET = 34.0, (0.012, -0.008)
BENDS = (-0.2, 0.06, 0.01, 0.2, 0.006, -0.004)


def project(c: int, bends: tuple[float, ...], width: int, height: int) -> np.ndarray:
    """Project as "RealityCapture XMP Camera Math" says; the center of the first pixel is at (0.5, 0.5)."""
    k1, k2, k3, k4, t1, t2 = bends
    R, t = blobs.poses()[c]
    position = -R.T @ t
    x, y, z = R @ (blobs.POINTS - position).T
    x, y = x / z, y / z
    square = x**2 + y**2
    radial = 1 + k1 * square + k2 * square**2 + k3 * square**3 + k4 * square**4
    x_bent = x * radial + t1 * (square + 2 * x**2) + 2 * t2 * x * y
    y_bent = y * radial + t2 * (square + 2 * y**2) + 2 * t1 * x * y
    scale = max(width, height)
    u = (F35 / 36 * x_bent + OFFSET[0]) * scale + width / 2
    v = (F35 / 36 * y_bent + OFFSET[1]) * scale + height / 2
    return np.stack([u, v], 1)


def xmp(c: int, model: str, bends: tuple[float, ...], attributes: bool, more: str = 'xcr:Skew="0"') -> str:
    R, t = blobs.poses()[c]
    values = {"Rotation": R.ravel(), "Position": -R.T @ t, "DistortionCoeficients": bends}
    texts = {key: " ".join(str(float(number)) for number in value) for key, value in values.items()}
    within = " ".join(f'xcr:{key}="{text}"' for key, text in texts.items()) if attributes else ""
    below = "" if attributes else "".join(f"<xcr:{key}>{text}</xcr:{key}>" for key, text in texts.items())
    return (
        f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description xcr:Version="3" xcr:PosePrior="initial" xcr:Coordinates="absolute" xcr:DistortionModel="{model}" '
        f'xcr:FocalLength35mm="{F35}" {more} xcr:AspectRatio="1" xcr:PrincipalPointU="{OFFSET[0]}" '
        f'xcr:PrincipalPointV="{OFFSET[1]}" {within} xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#">{below}'
        f"</rdf:Description></rdf:RDF></x:xmpmeta>"
    )


@pytest.mark.parametrize(
    ("model", "bends", "size"),
    [
        ("brown4t2", BENDS, (160, 120)),
        ("brown3", (*BENDS[:3], 0.0, 0.0, 0.0), (160, 160)),
        ("perspective", (0.0,) * 6, (120, 160)),
    ],
)
def test_images_with_xmp_files(tmp_path: Path, model: str, bends: tuple[float, ...], size: tuple[int, int]) -> None:
    for c in range(4):
        (tmp_path / f"IMG_{c}.xmp").write_text(xmp(c, model, bends, attributes=c % 2 == 0))
        Image.fromarray(blobs.draw(project(c, bends, *size), 0.5, *size)).save(tmp_path / f"IMG_{c}.png")
    (tmp_path / "IMG_9.xmp").write_text("<x/>")
    capture = open_capture(tmp_path)
    assert (capture.layout, capture.frames, capture.width, capture.height) == ("RealityCapture", 1, *size)
    assert capture.notes[0] == f"{tmp_path}: without a pose, and left out: IMG_9.xmp"
    assert blobs.errors(capture).max() < 0.1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (xmp(0, "division", BENDS, True), r"IMG_0\.xmp: has the lens division"),
        (xmp(0, "brown3", BENDS, True, 'xcr:Skew="0.1"'), r"with skew 0\.1"),
        (xmp(0, "brown3", BENDS[:4], True), r"IMG_0\.xmp: cannot be read \('-0\.2 0\.06 0\.01 0\.2' is not 6 numbers"),
        ("<x capturingreality.com/ns/xcr", r"IMG_0\.xmp: is not a complete XML file"),
        ('<x a="capturingreality.com/ns/xcr"/>', r"its XMP files hold no poses"),
        ("<x/>", r"holds none of these"),
    ],
)
def test_unusable_files_are_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "IMG_0.xmp").write_text(text)
    with pytest.raises(CaptureError, match=message):
        open_capture(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes")
def test_pipes_and_devices_among_xmp_files_do_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "IMG_0.xmp")
    (tmp_path / "IMG_1.xmp").symlink_to("/dev/zero")
    with pytest.raises(CaptureError, match="holds none of these"):
        open_capture(tmp_path)
    (tmp_path / "IMG_2.xmp").write_text(xmp(0, "perspective", (0,) * 6, True))
    with pytest.raises(CaptureError, match=r"IMG_[01]\.xmp: is (a pipe or a device|neither a file nor a folder)"):
        open_capture(tmp_path)


def test_deeply_nested_xmp_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "IMG_0.xmp").write_text('<x xmlns="http://www.capturingreality.com/ns/xcr/1.1#">' + "<a>" * 1000)
    with pytest.raises(CaptureError, match=r"IMG_0\.xmp: .*nested more than 64 deep"):
        open_capture(tmp_path)
