"""Images of a subject: composed by soft masks over the color of each camera."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.capture.masked_capture import LIKELY, PALETTE, UNLIKELY, MaskedCapture, is_doubtful
from splatreel.capture.opening import open_capture
from splatreel.scene.camera import Camera
from splatreel.scene.reel_source import ReelSource
from tests.capture import folders
from tests.method.captures import WallCapture


class Ramp:
    """Masks that are opaque on the left and transparent on the right."""

    def __init__(self, have_doubts: bool = False) -> None:
        self.have_doubts, self.notes = have_doubts, list[str]()

    def read(self, first: int, count: int, name: str) -> np.ndarray:
        return np.tile(np.linspace(255, 0, 48).round().astype(np.uint8), (count, 32, 1))

    def sources(self, first: int, count: int) -> list[Path]:
        return []

    def digest(self, first: int, count: int) -> str:
        return "ramp"

    def close(self) -> None:
        """Nothing is open."""


def test_pixels_in_doubt_show_what_is_likely() -> None:
    scene = WallCapture(1)
    names = [camera.name for camera in scene.cameras]
    capture, levels = MaskedCapture(scene, Ramp(have_doubts=True)), Ramp().read(0, 1, "")[0]
    doubtful = (levels >= 64) & (levels < 192)
    alpha = capture.alpha(0, 1, names)[0]
    assert np.array_equal(alpha[0][doubtful], np.where(levels < 128, UNLIKELY, LIKELY)[doubtful])
    assert np.array_equal(alpha[0][~doubtful], levels[~doubtful])
    likely, unlikely = doubtful & (levels >= 128), doubtful & (levels < 128)
    found, seen = capture.read(0, 1, names)[0], scene.read(0, 1, names)[0]
    assert np.array_equal(found[:, likely], seen[:, likely])
    for image, name in zip(found, names, strict=True):
        assert (image[unlikely] == 255 * np.array(capture.backgrounds[name])).all()


def test_opacities_of_soft_masks_are_never_in_doubt() -> None:
    scene = WallCapture(1)
    assert not is_doubtful(MaskedCapture(scene, Ramp()).alpha(0, 1, [scene.cameras[0].name])).any()


def test_soft_masks_blend_the_image_with_the_color_of_its_camera() -> None:
    scene = WallCapture(2)
    capture = MaskedCapture(scene, Ramp())
    names = [camera.name for camera in scene.cameras]
    alpha = capture.alpha(0, 2, names)
    assert alpha.shape == (2, 4, 32, 48)
    share = alpha[..., None] / 255
    colors = 255 * np.array([capture.backgrounds[name] for name in names])[:, None, None]
    expected = share * scene.read(0, 2, names) + (1 - share) * colors
    np.testing.assert_allclose(capture.read(0, 2, names), expected, atol=0.51)
    assert capture.scene is scene


def test_cameras_have_different_backgrounds_for_training_and_one_otherwise() -> None:
    capture = MaskedCapture(WallCapture(1, cameras=10), Ramp())
    colors = [capture.backgrounds[camera.name] for camera in capture.cameras]
    assert colors == [*PALETTE, *PALETTE[:2]]
    gray = MaskedCapture(WallCapture(1), Ramp(), (0.2, 0.2, 0.2))
    assert set(gray.backgrounds.values()) == {(0.2, 0.2, 0.2)}
    assert gray.read(0, 1, ["cam01"])[0, 0, 0, -1].tolist() == [51, 51, 51]


def test_opacity_of_the_images_themselves_counts_once(tmp_path: Path) -> None:
    """Images with an opacity are composed over black when they are read."""
    scene = folders.panoptic(tmp_path / "scene")
    for file in (scene / "ims").rglob("*.png"):
        Image.new("RGBA", (32, 24), (200, 100, 50, 128)).save(file)
    capture = open_capture(scene, masks=scene / "ims", background=(1.0, 1.0, 1.0))
    share = 128 / 255
    expected = share * np.array([200, 100, 50]) + (1 - share) * 255
    np.testing.assert_allclose(capture.read(0, 1, ["2"])[0, 0, 5, 5], expected, atol=1)


@pytest.mark.parametrize("width", [None, 16])
def test_facts_are_those_of_the_capture(tmp_path: Path, width: int | None) -> None:
    scene = folders.panoptic(tmp_path / "scene")
    masks = tmp_path / "masks"
    for camera in ("1", "2", "10", "12"):
        (masks / camera).mkdir(parents=True)
        for t in range(5):
            Image.new("L", (32, 24), 255).save(masks / camera / f"{t:06d}.png")
    plain = open_capture(scene, width=width, frames=(1, 4), held_out=["12"])
    capture = open_capture(scene, width=width, frames=(1, 4), held_out=["12"], masks=masks)
    for name in ("layout", "name", "frames", "first_frame", "fps", "held_out", "width", "height", "near", "origin"):
        assert getattr(capture, name) == getattr(plain, name), name
    assert [camera.name for camera in capture.cameras] == [camera.name for camera in plain.cameras]
    assert isinstance(capture.camera("1"), Camera)
    names = ["1", "10"]
    np.testing.assert_array_equal(capture.read(0, 3, names), plain.read(0, 3, names))  # everything is the subject
    np.testing.assert_array_equal(capture.missing(0, 3, names), plain.missing(0, 3, names))


def test_reel_of_a_subject_says_so() -> None:
    assert MaskedCapture(WallCapture(2), Ramp()).reel_source() == ReelSource(0, part="masks")
