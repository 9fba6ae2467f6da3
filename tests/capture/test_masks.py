""""""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.capture.base import Capture
from splatreel.capture.masks import (
    DOUBT,
    LIKELY,
    PALETTE,
    UNLIKELY,
    MaskedCapture,
    is_doubtful,
    level_of_opacity,
    opacity_of_level,
    read_mask_record,
    without_mixing,
)
from splatreel.capture.opening import open_capture
from splatreel.scene.camera import Camera
from splatreel.scene.reel_source import ReelSource
from tests.capture import folders
from tests.capture.folders import HEIGHT, WIDTH
from tests.method.captures import WallCapture

CAMERAS = ("1", "2", "10", "12")
FRAMES = 5


def mask(number: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """A mask that encodes its frame: a bar, one sixteenth of the image wide for each frame, half of it gray."""
    image = np.zeros((height, width), np.uint8)
    image[: height // 2, : (number + 1) * width // 16] = 255
    image[height // 2 :, : (number + 1) * width // 16] = 128
    return image


def bar(alpha: np.ndarray) -> int:
    """The frame that a mask encodes."""
    return round(16 * (alpha[0] > 127).mean()) - 1


def write_masks(folder: Path, name: Callable[[int], str] = "{:06d}.png".format) -> Path:
    for camera in CAMERAS:
        (folder / camera).mkdir(parents=True)
        for frame in range(FRAMES):
            Image.fromarray(mask(frame)).save(folder / camera / name(frame))
    return folder


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return folders.panoptic(tmp_path / "scene", FRAMES)


def masked(scene: Path, masks: Path, **options: object) -> Capture:
    return open_capture(scene, masks=masks, **options)  # type: ignore[arg-type]


def frames_of(capture: Capture, camera: str) -> list[int]:
    alpha = capture.alpha(0, capture.frames, [camera])
    assert alpha is not None
    return [bar(image) for image in alpha[:, 0]]


@pytest.mark.parametrize("name", ["{:06d}.png", "mask_{}.png", "{:06d}.jpg"])
def test_masks_are_of_the_frame_that_their_name_or_place_says(scene: Path, tmp_path: Path, name: str) -> None:
    masks = write_masks(tmp_path / "masks", name.format)
    assert frames_of(masked(scene, masks), "12") == [0, 1, 2, 3, 4]
    assert frames_of(masked(scene, masks, frames=(2, 4)), "2") == [2, 3]


def test_masks_of_the_same_names_are_needed_for_the_chosen_frames_only(scene: Path, tmp_path: Path) -> None:
    masks = write_masks(tmp_path / "masks")
    (masks / "2" / "000004.png").unlink()
    assert frames_of(masked(scene, masks, frames=(1, 4)), "2") == [1, 2, 3]
    with pytest.raises(CaptureError, match=r"masks/2: there is no mask 000004 .* camera 2\..* 000000 to 000003"):
        masked(scene, masks)


def test_mask_videos_follow_the_frames_of_the_cameras(tmp_path: Path) -> None:
    scene = folders.neu3dv(tmp_path / "scene")
    (tmp_path / "masks").mkdir()
    for c in range(4):
        images = [np.repeat(mask(t)[..., None], 3, 2) for t in range(folders.FRAMES)]
        folders.write_video(tmp_path / "masks" / f"cam{c:02d}.mp4", images)
    capture = masked(scene, tmp_path / "masks", frames=(3, 7))
    assert frames_of(capture, "cam02") == [3, 4, 5, 6]
    capture.close()
    folders.write_video(tmp_path / "masks" / "cam01.mp4", images[:-1])
    with pytest.raises(CaptureError, match=r"cam01\.mp4: holds 11 masks, but camera cam01 has 12 frames"):
        masked(scene, tmp_path / "masks")


def test_masks_of_video_cameras_may_be_images(tmp_path: Path) -> None:
    scene, masks = folders.neu3dv(tmp_path / "scene"), tmp_path / "masks"
    for camera in ("cam00", "cam01", "cam02", "cam03"):
        (masks / camera / "images").mkdir(parents=True)
        for t in range(folders.FRAMES):
            Image.fromarray(mask(t)).save(masks / camera / "images" / f"{t}.png")
    assert frames_of(masked(scene, masks), "cam03") == list(range(folders.FRAMES))  # 2.png comes before 10.png


def test_single_images_have_a_mask_each(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene, masks = folders.colmap(tmp_path / "scene"), tmp_path / "masks"
    (masks / "view").mkdir(parents=True)
    for camera in open_capture(scene).cameras:
        Image.fromarray(mask(7)).save(masks / f"{camera.name}.png")
    assert frames_of(masked(scene, masks), "view/cam02") == [7]


def test_masks_are_undistorted_as_the_images(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = folders.easyvolcap(tmp_path / "scene", bends=(-0.15, 0.02, 0.004, -0.003, 0.01), size=1)
    for file in (scene / "images").rglob("*.png"):
        target = tmp_path / "masks" / file.relative_to(scene / "images")
        target.parent.mkdir(parents=True, exist_ok=True)
        image = np.repeat(mask(6)[..., None], 3, 2)
        Image.fromarray(image).save(file)
        Image.fromarray(image).save(target)
    capture = masked(scene, tmp_path / "masks")
    alpha = capture.alpha(0, 1, ["02"])
    assert alpha is not None
    # Opacities of 127 and 128 are changed by one, since these values mean doubt.
    np.testing.assert_allclose(alpha[0, 0], capture.scene.read(0, 1, ["02"])[0, 0, ..., 0].astype(int), atol=1)


def test_opacity_of_a_image_is_its_mask(scene: Path, tmp_path: Path) -> None:
    """The color of a cut-out does not count."""
    masks = write_masks(tmp_path / "masks")
    for file in (masks / "1").iterdir():
        with Image.open(file) as image:
            alpha = image.convert("L")
        cutout = Image.merge("RGBA", [*Image.new("RGB", alpha.size, (10, 200, 30)).split(), alpha])
        cutout.save(file)
    assert frames_of(masked(scene, masks), "1") == [0, 1, 2, 3, 4]


def test_smaller_masks_of_the_same_shape_are_enlarged(scene: Path, tmp_path: Path) -> None:
    masks = write_masks(tmp_path / "masks")
    for frame in range(FRAMES):
        Image.fromarray(mask(frame, WIDTH // 2, HEIGHT // 2)).save(masks / "1" / f"{frame:06d}.png")
    assert frames_of(masked(scene, masks), "1") == [0, 1, 2, 3, 4]


def with_opacity(file: Path, opacity: int | None, mode: str) -> None:
    """Save a mask again with an opacity: the same everywhere, or None for a transparent frame around an opaque image."""
    with Image.open(file) as image:
        gray = Image.fromarray(np.where(np.asarray(image.convert("L")) > 0, np.uint8(255), np.uint8(0)))
    alpha = Image.new("L", gray.size, 0 if opacity is None else opacity)
    if opacity is None:
        alpha.paste(255, (0, 0, WIDTH - 1, HEIGHT))
    Image.merge(mode, [*[gray] * (len(mode) - 1), alpha]).save(file)


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
@pytest.mark.parametrize("opacity", [255, 252, 40, None])
def test_gray_levels_count_where_the_opacity_says_nothing(
    scene: Path, tmp_path: Path, opacity: int | None, mode: str
) -> None:
    masks = write_masks(tmp_path / "masks")
    for file in (masks / "1").iterdir():
        with_opacity(file, opacity, mode)
    assert frames_of(masked(scene, masks), "1") == [0, 1, 2, 3, 4]


def test_transparent_masks_and_opaque_images_are_refused(scene: Path, tmp_path: Path) -> None:
    masks = write_masks(tmp_path / "masks")
    with_opacity(masks / "1" / "000000.png", 0, "RGBA")
    with pytest.raises(CaptureError, match=r"000000\.png: is transparent everywhere.*Save it without an opacity"):
        masked(scene, masks).alpha(0, 1, ["1"])
    Image.new("RGBA", (WIDTH, HEIGHT), (10, 200, 30, 255)).save(masks / "1" / "000000.png")
    with pytest.raises(CaptureError, match=r"colored.* A cut-out is transparent around the subject"):
        masked(scene, masks).alpha(0, 1, ["1"])


def test_levels_of_8_bits_in_files_of_16_bits(scene: Path, tmp_path: Path) -> None:
    masks = write_masks(tmp_path / "masks")
    levels = np.zeros((HEIGHT, WIDTH), np.uint16)
    for frame in range(FRAMES):
        levels = np.where(mask(frame) > 0, np.uint16(255), np.uint16(0))
        Image.fromarray(levels).save(masks / "1" / f"{frame:06d}.png")
    capture, shown = masked(scene, masks), np.minimum(levels, 1)
    assert frames_of(capture, "1") == [0, 1, 2, 3, 4]
    for level in (1, 254, 1000):
        Image.fromarray(shown * np.uint16(level)).save(masks / "1" / "000000.png")
        with pytest.raises(CaptureError, match=rf"000000\.png: the brightest pixel of this mask is {level} of 65535"):
            capture.alpha(0, 1, ["1"])


def test_colors_of_16_bits_with_levels_of_8_bits_are_refused(scene: Path, tmp_path: Path) -> None:
    """Pillow reads their upper 8 bits, which are black."""
    cv2 = pytest.importorskip("cv2")
    masks = write_masks(tmp_path / "masks")
    capture, file = masked(scene, masks), masks / "1" / "000000.png"
    for level in (255, 1):
        cv2.imwrite(str(file), np.repeat((mask(1) > 0).astype(np.uint16)[..., None] * level, 3, 2))
        with pytest.raises(CaptureError, match=rf"000000\.png: .* is {level} of 65535"):
            capture.alpha(0, 1, ["1"])
    cv2.imwrite(str(file), np.repeat((mask(1) > 0).astype(np.uint16)[..., None] * 65535, 3, 2))
    assert frames_of(capture, "1")[0] == 1
    cv2.imwrite(str(file), np.zeros((HEIGHT, WIDTH, 3), np.uint16))
    assert frames_of(capture, "1")[0] == -1


@pytest.mark.parametrize("name", ["{:06d}.png", "{:04d}.png", "mask_{}_1.png"])
@pytest.mark.parametrize("offset", [1, 100, 3])
def test_masks_that_count_from_another_number_are_paired_in_order(
    scene: Path, tmp_path: Path, name: str, offset: int
) -> None:
    """Frames 1 to 4 have masks of their names, which are those of the frames before."""
    masks = write_masks(tmp_path / "masks", lambda frame: name.format(frame + offset))
    whole, some = masked(scene, masks), masked(scene, masks, frames=(1, 4))
    assert frames_of(whole, "12") == [0, 1, 2, 3, 4]
    assert frames_of(some, "12") == [1, 2, 3]
    first = name.format(offset).removesuffix(".png")
    for capture in (whole, some):
        assert (
            f"masks of {', '.join(CAMERAS)} begin at {first} where its images begin at 000000: they are paired in order"
            in (capture.notes)
        )


def test_masks_that_count_from_another_number_and_are_too_few_are_refused(scene: Path, tmp_path: Path) -> None:
    masks = write_masks(tmp_path / "masks", lambda frame: f"{frame + 1:06d}.png")
    (masks / "2" / "000003.png").unlink()
    for frames in (None, (1, 3)):
        with pytest.raises(CaptureError, match=r"no mask 000000, and no image 000005\. .*rename the masks"):
            masked(scene, masks, frames=frames)


def test_masks_of_some_images_are_paired_by_name_and_said(scene: Path, tmp_path: Path) -> None:
    masks = write_masks(tmp_path / "masks")
    (masks / "2" / "000000.png").unlink()
    capture = masked(scene, masks, frames=(1, 3))
    assert frames_of(capture, "2") == [1, 2]
    assert capture.notes[-1] == "masks of 2 are 4 for 5 images and are paired with those of the same names"


def remove_camera(masks: Path) -> None:
    for file in (masks / "12").iterdir():
        file.unlink()
    (masks / "12").rmdir()


def empty_camera(masks: Path) -> None:
    for file in (masks / "12").iterdir():
        file.unlink()


def one_too_few(masks: Path) -> None:
    for number, file in enumerate(sorted((masks / "12").iterdir())):
        file.rename(file.with_name(f"m{number}.png")) if number else file.unlink()


def wrong_size(masks: Path) -> None:
    Image.fromarray(mask(0, 24, 24)).save(masks / "12" / "000000.png")


def add_video(masks: Path) -> None:
    remove_camera(masks)
    for suffix in (".mp4", ".webm"):
        (masks / f"12{suffix}").touch()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (remove_camera, r"masks: there are no masks of camera 12\. Add a folder 12 .*--leave-out 12"),
        (empty_camera, r"masks/12: holds no images.*camera 12"),
        (one_too_few, r"masks/12: holds 4 masks, but camera 12 has 5 frames\. .*or name the masks as the images"),
        (wrong_size, r"12/000000\.png: is 24x24, but the images of camera 12 are 32x24"),
        (add_video, r"both 12\.mp4 and 12\.webm are masks of camera 12"),
    ],
)
def test_masks_that_do_not_fit_are_refused(
    scene: Path, tmp_path: Path, spoil: Callable[[Path], None], message: str
) -> None:
    masks = write_masks(tmp_path / "masks")
    spoil(masks)
    with pytest.raises(CaptureError, match=message):
        masked(scene, masks)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        ((mask(1) > 0).astype(np.uint8), r"brightest pixel of frame 1 is 1 of 255\. Write the subject as white"),
        (np.stack([mask(1), 0 * mask(1), mask(1)], 2), r"000001\.png: frame 1 is colored"),
        (mask(1, 24, 24), r"000001\.png: is 24x24, the first image of its camera is 32x24"),
    ],
)
def test_images_that_are_no_masks_are_refused(scene: Path, tmp_path: Path, image: np.ndarray, message: str) -> None:
    masks = write_masks(tmp_path / "masks")
    Image.fromarray(image).save(masks / "2" / "000001.png")
    with pytest.raises(CaptureError, match=message):
        masked(scene, masks).read(0, 2, ["2"])


def test_folder_is_needed(scene: Path, tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match=r"none: is not a folder of masks"):
        masked(scene, tmp_path / "none")


def test_identity_changes_with_the_content_of_the_masks(scene: Path, tmp_path: Path) -> None:
    masks = write_masks(tmp_path / "masks")
    before = masked(scene, masks).describe()
    assert masked(scene, masks).describe() == before
    Image.fromarray(mask(6)).save(masks / "2" / "000001.png")
    after = masked(scene, masks).describe()
    assert after != before
    assert {**after, "masks": before["masks"]} == before
    assert "masks" not in open_capture(scene).describe()
    chosen = masked(scene, masks, frames=(2, 4)).describe()
    Image.fromarray(mask(7)).save(masks / "2" / "000001.png")
    assert masked(scene, masks, frames=(2, 4)).describe() == chosen  # another frame


def test_cameras_that_are_not_compared_need_no_masks(scene: Path, tmp_path: Path) -> None:
    masks = write_masks(tmp_path / "masks")
    shutil.rmtree(masks / "2")
    assert frames_of(masked(scene, masks, masked=["1", "12"]), "12") == [0, 1, 2, 3, 4]
    with pytest.raises(CaptureError, match="there are no masks of camera 2"):
        masked(scene, masks)


@pytest.mark.parametrize("empty", [False, True])
def test_held_out_cameras_need_no_masks(scene: Path, tmp_path: Path, empty: bool) -> None:
    masks = write_masks(tmp_path / "masks")
    shutil.rmtree(masks / "2")
    if empty:
        (masks / "2").mkdir()
    capture = masked(scene, masks, held_out=["2"])
    assert list(capture.unmasked) == ["2"]
    assert "there are no masks of 2, which training does not need" in capture.notes[-1]
    assert not capture.alpha(0, 5, ["2"]).any()
    assert list(masked(scene, masks, held_out=["1"], masked=["1", "2"]).unmasked) == ["2"]
    with pytest.raises(CaptureError, match=r"there are no masks of camera 2|holds no images"):
        masked(scene, masks, held_out=["1"])


def test_masks_of_a_video_that_the_program_made_may_be_of_some_frames(tmp_path: Path) -> None:
    scene, masks = folders.neu3dv(tmp_path / "scene"), tmp_path / "masks"
    capture = open_capture(scene)
    for camera in capture.cameras:
        (masks / camera.name).mkdir(parents=True)
        for frame in (1, 2):
            Image.fromarray(mask(frame, capture.width, capture.height)).save(masks / camera.name / f"{frame:06d}.png")
    with pytest.raises(CaptureError, match="holds 2 masks, but camera"):
        masked(scene, masks, frames=(1, 3))
    (masks / "splatreel-masks.json").write_text('{"undistorted": true}')
    assert frames_of(masked(scene, masks, frames=(1, 3)), capture.cameras[0].name) == [1, 2]
    with pytest.raises(CaptureError, match="there is no mask 000000"):
        masked(scene, masks, frames=(0, 2))


@pytest.mark.parametrize("kind", ["pipe", "deep", "long", "list"])
def test_hostile_record_of_masks_is_refused(tmp_path: Path, kind: str) -> None:
    record = tmp_path / "splatreel-masks.json"
    if kind == "pipe":
        if not hasattr(os, "mkfifo"):
            pytest.skip("pipes")
        os.mkfifo(record)
    else:
        record.write_text({"deep": "[" * 100_000 + "]" * 100_000, "long": " " * 2_000_000, "list": "[]"}[kind])
    with pytest.raises(CaptureError, match=r"splatreel-masks\.json: .*Delete the folder, and make the masks again"):
        read_mask_record(tmp_path)


def test_folder_without_a_record_of_masks(tmp_path: Path) -> None:
    assert read_mask_record(tmp_path) is None
    assert read_mask_record(tmp_path / "absent") is None


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
    assert np.array_equal(is_doubtful(alpha[0]), doubtful)
    likely, unlikely = doubtful & (levels >= 128), doubtful & (levels < 128)
    found, seen = capture.read(0, 1, names)[0], scene.read(0, 1, names)[0]
    assert np.array_equal(found[:, likely], seen[:, likely])
    opacity = np.where(doubtful, np.where(levels < 128, np.uint8(0), np.uint8(255)), opacity_of_level(levels))
    for image, plain, name in zip(found, seen, names, strict=True):
        assert (image[unlikely] == 255 * np.array(capture.backgrounds[name])).all()
        share = opacity[..., None] / 255
        expected = share * without_mixing(plain, opacity) + (1 - share) * 255 * np.array(capture.backgrounds[name])
        np.testing.assert_allclose(image, expected, atol=0.51)


def test_levels_out_of_doubt_tell_the_opacity() -> None:
    opacities = np.arange(256, dtype=np.uint8)
    levels = level_of_opacity(opacities)
    assert not ((levels >= DOUBT[0]) & (levels < DOUBT[1])).any()
    found = opacity_of_level(levels)
    assert not is_doubtful(found).any()
    assert np.abs(found.astype(int) - opacities).max() == 1
    assert found[[0, -1]].tolist() == [0, 255]


def test_mixed_border_pixels_show_the_subject_alone() -> None:
    """A red body before a gray wall, one column of whose border mixes both."""
    image = np.full((8, 9, 3), 128, np.uint8)
    image[:, :4] = 200, 20, 30
    opacity = np.zeros((8, 9), np.uint8)
    opacity[:, :4], opacity[:, 4] = 255, 100
    image[:, 4] = 156, 86, 90
    found = without_mixing(image, opacity)
    assert (found[:, :5] == (200, 20, 30)).all()
    assert np.array_equal(found[:, 5:], image[:, 5:])
    alone = np.zeros_like(opacity)
    alone[:, 4] = 100
    assert np.array_equal(without_mixing(image, alone), image)


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
