import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageCms, ImageOps

from splatreel.base.errors import CaptureError
from splatreel.capture.files import LOCAL
from splatreel.capture.images import CameraImages, image_size, read_header, read_image, same_shape
from tests.capture.colors import COLORS, display_p3_profile, png_chunk, write_png16

NOISE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
SIDEWAYS = 6
"""Number in EXIF of images whose top is at the right."""


def turned(number: int = SIDEWAYS) -> Image.Exif:
    exif = Image.Exif()
    exif[0x112] = number
    return exif


def palette(colors: np.ndarray) -> Image.Image:
    """Return an image with a palette, whose pixels are all colors in order."""
    image = Image.fromarray(np.arange(len(colors), dtype=np.uint8)[None], "P")
    image.putpalette(colors.astype(np.uint8).tobytes())
    return image


def test_image_is_resized_by_area(tmp_path: Path) -> None:
    Image.fromarray(NOISE).save(tmp_path / "a.png")
    mean = NOISE.reshape(12, 2, 16, 2, 3).mean((1, 3))
    assert image_size(tmp_path / "a.png") == (32, 24)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", 32, 24), NOISE)
    assert np.abs(read_image(tmp_path / "a.png", 16, 12) - mean).max() <= 1.5


@pytest.mark.parametrize("suffix", ["png", "tif", "bmp", "webp", "jpg"])
def test_plain_images_have_pillows_pixels(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"a.{suffix}"
    Image.fromarray(NOISE).save(file, lossless=True)
    with Image.open(file) as image:
        np.testing.assert_array_equal(read_image(file, 32, 24), np.asarray(image))
    assert read_header(file).conversions == []


@pytest.mark.parametrize("mode", ["1", "L", "P"])
def test_gray_and_palettes_become_rgb(tmp_path: Path, mode: str) -> None:
    values = [0, 255] if mode == "1" else list(range(256))
    colors = np.random.default_rng(1).integers(0, 256, (256, 3)) if mode == "P" else np.repeat(values, 3).reshape(-1, 3)
    image = palette(colors) if mode == "P" else Image.fromarray(np.array([values], np.uint8)).convert(mode)
    image.save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", len(colors), 1)[0], colors)


@pytest.mark.parametrize("channels", [0, 2, 3, 4])
def test_sixteen_bits_are_scaled(tmp_path: Path, channels: int) -> None:
    values = (
        np.random.default_rng(0).integers(0, 1 << 16, (24, 32, channels) if channels else (24, 32)).astype(np.uint16)
    )
    values[0], values[1] = 0, 65535
    if channels in (2, 4):
        values[..., -1] = 65535
    write_png16(tmp_path / "a.png", values)
    gray = values if channels == 0 else values[..., 0]
    expected = (values[..., :3] if channels > 2 else np.repeat(gray[..., None], 3, 2)) / 257
    assert np.abs(read_image(tmp_path / "a.png", 32, 24) - expected).max() <= 1


def test_gray_tiff_with_sixteen_bits_is_scaled(tmp_path: Path) -> None:
    values = np.linspace(0, 65535, 32 * 24).astype(np.uint16).reshape(24, 32)
    Image.fromarray(values).save(tmp_path / "a.tif")
    assert np.abs(read_image(tmp_path / "a.tif", 32, 24)[..., 1] - values / 257).max() <= 1
    assert read_header(tmp_path / "a.tif").conversions == ["16 bits are reduced to 8"]


@pytest.mark.parametrize("values", [np.float32(0.5), np.int32(1 << 20)])
def test_numbers_without_a_known_white_are_refused(tmp_path: Path, values: np.generic) -> None:
    Image.fromarray(np.full((8, 8), values)).save(tmp_path / "a.tif")
    with pytest.raises(CaptureError, match=r"a\.tif: cannot be read as an image \(its pixels are of kind [FI]"):
        read_image(tmp_path / "a.tif", 8, 8)


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P"])
def test_alpha_is_composed_over_black(tmp_path: Path, mode: str) -> None:
    color = np.array([90, 90, 90] if mode == "LA" else [200, 100, 50])
    image = np.full((2, 4, 4), [*color, 255], np.uint8)
    image[0, 1:3, 3] = 0, 255 if mode == "P" else 51
    Image.fromarray(image).convert(mode).save(tmp_path / "a.png")
    found = read_image(tmp_path / "a.png", 4, 2)
    assert found[0, 1].tolist() == [0, 0, 0]
    assert np.abs(found[1] - color).max() <= 1
    if mode != "P":
        assert found[0, 2].tolist() == (color // 5).tolist()
    assert read_header(tmp_path / "a.png").conversions == ["transparent pixels are composed over black"]


def test_opaque_alpha_changes_nothing(tmp_path: Path) -> None:
    Image.fromarray(NOISE).convert("RGBA").save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", 32, 24), NOISE)


@pytest.mark.parametrize("number", range(1, 9))
@pytest.mark.parametrize("suffix", ["png", "webp", "jpg", "tif"])
def test_exif_turns_images_as_pillow_and_opencv_do(tmp_path: Path, suffix: str, number: int) -> None:
    file = tmp_path / f"a.{suffix}"
    Image.fromarray(NOISE).save(file, lossless=True, exif=turned(number))
    with Image.open(file) as image:
        expected = np.asarray(ImageOps.exif_transpose(image))
    assert image_size(file) == expected.shape[1::-1]
    np.testing.assert_array_equal(read_image(file, *image_size(file)), expected)
    small = read_image(file, expected.shape[1] // 2, expected.shape[0] // 2)
    assert np.abs(small - expected.reshape(expected.shape[0] // 2, 2, -1, 2, 3).mean((1, 3))).max() <= 2
    if suffix != "tif":
        assert read_image(file, 32, 24, upright=False).shape == (24, 32, 3)


def test_exif_behind_the_pixels_of_a_png_counts(tmp_path: Path) -> None:
    Image.fromarray(NOISE).save(tmp_path / "a.png")
    data = (tmp_path / "a.png").read_bytes()
    exif = turned().tobytes().removeprefix(b"Exif\0\0")
    (tmp_path / "a.png").write_bytes(data[:-12] + png_chunk(b"eXIf", exif) + data[-12:])
    assert image_size(tmp_path / "a.png") == (24, 32)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", 24, 32), np.rot90(NOISE, 3))


@pytest.mark.filterwarnings("ignore:Corrupt EXIF")
@pytest.mark.parametrize("exif", [b"", b"Exif\0\0", b"Exif\0\0MM\0*\0\0\0\x08\0\1", b"nonsense"])
def test_damaged_exif_is_ignored(tmp_path: Path, exif: bytes) -> None:
    Image.fromarray(NOISE).save(tmp_path / "a.webp", lossless=True, exif=exif)
    np.testing.assert_array_equal(read_image(tmp_path / "a.webp", 32, 24), NOISE)


@pytest.mark.parametrize("suffix", ["png", "jpg", "webp", "tif"])
def test_display_p3_is_converted(tmp_path: Path, suffix: str) -> None:
    """The primaries of sRGB in Display P3, as browsers show them, and a gray."""
    signal = np.array([(234, 51, 35), (117, 251, 76), (0, 0, 245), (100, 100, 100)], np.uint8)
    image = Image.fromarray(signal.repeat(16, 0).repeat(16, 0).reshape(4, 16, 16, 3).reshape(64, 16, 3))
    image.save(tmp_path / f"a.{suffix}", icc_profile=display_p3_profile(), quality=100, lossless=True)
    found = read_image(tmp_path / f"a.{suffix}", 16, 64)[8::16, 8].astype(int)
    assert np.abs(found - [(255, 0, 0), (0, 255, 0), (0, 0, 255), (100, 100, 100)]).max() <= 12  # steep near 0
    assert np.abs(found[3] - 100).max() <= 1
    assert read_header(tmp_path / f"a.{suffix}").conversions == ["colors are converted from the ICC profile to sRGB"]


@pytest.mark.parametrize("profile", [ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(), b"damaged"])
@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_profiles_of_srgb_and_damaged_ones_change_nothing(tmp_path: Path, mode: str, profile: bytes) -> None:
    image = Image.fromarray(NOISE).convert(mode)
    image.save(tmp_path / "a.png", icc_profile=profile)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", 32, 24), np.asarray(image.convert("RGB")))
    assert read_header(tmp_path / "a.png").conversions == []


def test_cmyk_is_converted(tmp_path: Path) -> None:
    inks = np.concatenate([255 - COLORS, np.zeros((8, 1), int)], 1).astype(np.uint8)
    Image.frombytes("CMYK", (8, 1), inks.tobytes()).save(tmp_path / "a.tif")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif", 8, 1)[0], COLORS)
    assert read_header(tmp_path / "a.tif").conversions == [
        "CMYK without a usable ICC profile is converted by its inverse"
    ]


@pytest.mark.parametrize("suffix", ["tif", "png", "webp"])
def test_further_images_of_a_file_are_named(tmp_path: Path, suffix: str) -> None:
    pages = [Image.fromarray(NOISE), Image.fromarray(255 - NOISE)]
    pages[0].save(tmp_path / f"a.{suffix}", save_all=True, append_images=pages[1:], lossless=True)
    assert read_header(tmp_path / f"a.{suffix}").conversions == ["only the first image of a file with several is read"]
    assert np.array_equal(read_image(tmp_path / f"a.{suffix}", 32, 24), NOISE)


def test_image_of_another_size_is_refused(tmp_path: Path) -> None:
    Image.fromarray(NOISE).save(tmp_path / "0001.png")
    with pytest.raises(CaptureError, match=r"0001\.png: is 32x24, the first image of its camera is 64x24"):
        read_image(tmp_path / "0001.png", 16, 12, size=(64, 24))


def test_file_that_is_no_image_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_text("no image")
    for read in (lambda: image_size(tmp_path / "a.png"), lambda: read_image(tmp_path / "a.png", 8, 8)):
        with pytest.raises(CaptureError, match=r"a\.png: cannot be read as an image"):
            read()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes")
def test_pipe_in_place_of_an_image_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(CaptureError, match=r"a\.png: is a pipe or a device"):
        image_size(tmp_path / "a.png")
    with pytest.raises(CaptureError, match=r"a\.png: is a pipe or a device"):
        read_image(tmp_path / "a.png", 4, 4)


"""Number in EXIF of images whose top is at the right."""


@pytest.fixture
def image(tmp_path: Path) -> Path:
    exif = Image.Exif()
    exif[0x112] = SIDEWAYS
    Image.fromarray(np.arange(36 * 64 * 3, dtype=np.uint8).reshape(36, 64, 3)).save(tmp_path / "a.png", exif=exif)
    return tmp_path / "a.png"


@pytest.mark.parametrize(
    ("size", "other"),
    [((618, 410), (4946, 3286)), ((1345, 1008), (2690, 2016)), ((620, 412), (4946, 3286)), ((64, 48), (64, 48))],
)
def test_rounded_sizes_have_one_shape(size: tuple[int, int], other: tuple[int, int]) -> None:
    assert same_shape(size, other)
    assert same_shape(other, size)
    assert not same_shape((size[0], size[1] + 5), other)
    assert not same_shape((size[1], size[0]), other)


@pytest.mark.parametrize("size", [(1920, 1088), (1440, 1080), (640, 480), (1080, 1920)])
def test_crops_and_other_shapes_differ(size: tuple[int, int]) -> None:
    assert not same_shape((1920, 1080), size)


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("calibrated", [None, (36, 64), (64, 36), (72, 128), (100, 100)])
def test_calibration_decides_about_exif(image: Path, upright: bool, calibrated: tuple[int, int] | None) -> None:
    images = CameraImages({"a": image}, LOCAL, upright)
    obeyed = {(36, 64): True, (72, 128): True, (64, 36): False}.get(calibrated or (0, 0), upright)
    assert images.size("a", calibrated) == ((36, 64) if obeyed else (64, 36))
    out = np.empty((64, 36, 3) if obeyed else (36, 64, 3), np.uint8)
    images.read(out, "a", image)
    with Image.open(image) as stored:
        np.testing.assert_array_equal(out, np.rot90(np.asarray(stored), 3 if obeyed else 0))
    assert images.conversions() == [f"all cameras: images are {'' if obeyed else 'not '}turned {_reason(obeyed)}"]


def _reason(obeyed: bool) -> str:
    return "upright as EXIF says" if obeyed else "as EXIF says, as in COLMAP"


def test_later_image_of_another_size_is_refused(image: Path) -> None:
    Image.new("RGB", (36, 72)).save(image.with_name("b.png"))
    images = CameraImages({"a": image}, LOCAL, True)
    with pytest.raises(CaptureError, match=r"b\.png: is 36x72, the first image of its camera is 36x64"):
        images.read(np.empty((64, 36, 3), np.uint8), "a", image.with_name("b.png"))
