"""Writing of masks: continuing, corrections by hand, and what is refused."""

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.masks import RECORD
from splatreel.capture.opening import open_capture
from splatreel.capture.time_steps import OwnFrames
from splatreel.segmentation.clean_plate import fitting_plates
from splatreel.segmentation.mask_writer import MODEL, WrittenMasks, _claim, _disagreeing, write_masks
from tests.segmentation import scenes

FRAMES = 8


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scenes.write_capture(tmp_path_factory.mktemp("scene"), FRAMES)


@pytest.fixture(scope="module")
def masks(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Masks of the scene. Tests do not change them."""
    folder = tmp_path_factory.mktemp("out") / "masks"
    make(scene, folder)
    return folder


def make(scene: Path, folder: Path, clean_plate: Path | None = None, **options: object) -> WrittenMasks:
    capture = open_capture(scene, held_out=[], **options)  # type: ignore[arg-type]
    assert isinstance(capture, FileCapture)
    return write_masks(capture, folder, Silent(), clean_plate)


def make_images(folder: Path) -> dict[str, bytes]:
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in sorted(folder.glob("*/*.png"))}


def test_written_masks_are_read_with_the_capture(scene: Path, masks: Path) -> None:
    capture = open_capture(scene, masks=masks, held_out=[])
    alpha = capture.alpha(0, FRAMES, [camera.name for camera in capture.cameras])
    assert alpha is not None
    assert scenes.overlap(alpha > 127, scenes.film(FRAMES)[1]) > 0.65
    assert not (masks / MODEL).exists()
    assert json.loads((masks / RECORD).read_text())["complete"]


def copied(masks: Path, folder: Path) -> Path:
    for file in [*masks.glob("*/*.png"), masks / RECORD]:
        target = folder / file.relative_to(masks)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(file.read_bytes())
    return folder


def test_interrupted_call_continues_to_the_same_masks(scene: Path, masks: Path, tmp_path: Path) -> None:
    folder = copied(masks, tmp_path / "masks")
    record = json.loads((folder / RECORD).read_text())
    (folder / RECORD).write_text(json.dumps(record | {"complete": False}))
    for name in ("1/000003.png", "2/000006.png", "5/000006.png"):
        (folder / name).unlink()
    assert make(scene, folder).images == 3
    assert make_images(folder) == make_images(masks)


def test_temporary_files_of_a_killed_call_are_removed(scene: Path, masks: Path, tmp_path: Path) -> None:
    """Also if it was killed before the folder had a record."""
    left = ".splatreel-masks.json.0123456789abcdef.tmp"
    folder = copied(masks, tmp_path / "masks")
    camera = next(path for path in folder.iterdir() if path.is_dir())
    next(camera.iterdir()).unlink()
    (camera / ".000000.png.0123456789abcdef.tmp").write_bytes(b"cut")
    (folder / left).write_bytes(b"{")
    make(scene, folder)
    assert [path.name for path in folder.rglob("*.tmp")] == []
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / left).write_bytes(b"{")
    assert make(scene, tmp_path / "new").images
    assert [path.name for path in (tmp_path / "new").rglob("*.tmp")] == []


def test_masks_corrected_by_hand_stay(scene: Path, masks: Path, tmp_path: Path) -> None:
    folder = copied(masks, tmp_path / "masks")
    Image.new("L", (scenes.WIDTH, scenes.HEIGHT), 255).save(folder / "1" / "000000.png")
    corrected = make_images(folder)
    assert make(scene, folder).images == 0
    assert make_images(folder) == corrected


def test_folder_of_other_frames_is_refused(scene: Path, masks: Path) -> None:
    with pytest.raises(CaptureError, match=r"frames is '0:8' there and '0:6' now"):
        make(scene, masks, frames=(0, 6))


def test_backgrounds_of_chosen_frames_are_found_in_the_whole_video(scene: Path, masks: Path, tmp_path: Path) -> None:
    """In two frames nobody leaves their place."""
    make(scene, tmp_path / "masks", frames=(2, 4))
    whole, some = make_images(masks), make_images(tmp_path / "masks")
    assert len(some) == 2 * scenes.CAMERAS
    for name, image in some.items():
        pair = [np.asarray(Image.open(io.BytesIO(data))) > 127 for data in (whole[name], image)]
        assert scenes.overlap(*pair) > 0.95, name


def test_folder_with_other_files_is_refused(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(CaptureError, match="holds no masks of `capture masks`"):
        make(scene, tmp_path)


def test_body_that_never_moves_needs_a_clean_plate(tmp_path: Path) -> None:
    scene = scenes.write_capture(tmp_path / "scene", 4, at=(0.2, 0.1))
    with pytest.raises(CaptureError, match=r"nothing moves in this capture.*--clean-plate FOLDER"):
        make(scene, tmp_path / "masks")
    plates = tmp_path / "plates"
    plates.mkdir()
    with pytest.raises(CaptureError, match=r"there is no clean plate of camera 1\. Add an image 1\.png"):
        make(scene, tmp_path / "masks2", plates)
    for c in range(scenes.CAMERAS):
        Image.fromarray(scenes.backdrop(c)).save(plates / f"{c + 1}.png")
    assert min(make(scene, tmp_path / "masks3", plates).shares.values()) > 0.01
    Image.new("RGB", (64, 64)).save(plates / "3.png")
    with pytest.raises(CaptureError, match=r"3\.png: is 64x64, but the images of camera 3 are 96x72"):
        make(scene, tmp_path / "masks4", plates)


def test_masks_of_a_video_are_named_by_the_numbers_of_its_frames(scene: Path, masks: Path, tmp_path: Path) -> None:
    folder = copied(masks, tmp_path / "masks")
    (folder / "1" / "000004.png").unlink()
    with pytest.raises(CaptureError, match="there is no mask 000004"):
        open_capture(scene, masks=folder, held_out=[])
    assert np.asarray(open_capture(scene, masks=folder, held_out=[], frames=(0, 4)).frames) == 4


def test_damaged_record_is_named(scene: Path, tmp_path: Path) -> None:
    (tmp_path / RECORD).write_text("{")
    with pytest.raises(CaptureError, match=RECORD):
        make(scene, tmp_path)


def test_images_that_a_camera_lacks_leave_its_other_masks_as_they_are(scene: Path, masks: Path, tmp_path: Path) -> None:
    capture = open_capture(scene, held_out=[])
    assert isinstance(capture, FileCapture)
    source, lacks = capture.source, np.isin(np.arange(FRAMES), (4, 5, 6))
    own = source.own_frames  # type: ignore[attr-defined]
    stand_ins = np.array([0, 1, 2, 3, 3, 3, 7, 7])

    def own_frames(name: str) -> OwnFrames:
        return replace(own(name), numbers=stand_ins) if name == "3" else own(name)

    source.own_frames = own_frames  # type: ignore[attr-defined]
    source.missing = lambda first, count, name: (lacks & (name == "3"))[first : first + count]  # type: ignore[method-assign]
    read = source.read_camera

    def read_camera(out: np.ndarray, first: int, name: str) -> None:
        for place, image in enumerate(out):
            read(image[None], int(stand_ins[first + place]) if name == "3" else first + place, name)

    source.read_camera = read_camera  # type: ignore[method-assign]
    write_masks(capture, tmp_path / "masks", Silent())
    made, expected = make_images(tmp_path / "masks"), make_images(masks)
    assert set(expected) - set(made) == {f"3/{t:06d}.png" for t in (4, 5, 6)}
    for t in (0, 3, 7):
        name = f"3/{t:06d}.png"
        pair = [np.asarray(Image.open(io.BytesIO(files[name]))) > 127 for files in (made, expected)]
        assert scenes.overlap(*pair) > 0.6, name


def test_clean_plates_that_contradict_the_capture_are_said_and_not_used() -> None:
    images = scenes.film(6)[0]
    names = [f"c{c}" for c in range(scenes.CAMERAS)]
    plates = [scenes.backdrop(c)[None] for c in range(scenes.CAMERAS)]
    there = np.ones(images.shape[:2], bool)
    used, notes = fitting_plates(names, plates, images, there)
    assert all(plate is not None for plate in used)
    assert notes == []
    plates[0], plates[1] = plates[1], plates[0]
    plates[3] = (0.5 * plates[3]).astype(np.uint8)
    h, w = scenes.HEIGHT // 4, scenes.WIDTH // 4
    plates[4] = np.asarray(Image.fromarray(plates[4][0, h:-h, w:-w]).resize((scenes.WIDTH, scenes.HEIGHT)))[None]
    used, notes = fitting_plates(names, plates, images, there)
    assert [plate is None for plate in used] == [True, True, False, True, True, False]
    said = [" ".join(note.split()[3:8]) for note in notes]
    assert said[0] == "of c0 shows what camera"
    assert "another light, 0.5 times" in notes[2]
    assert "another zoom" in notes[3]


def test_cameras_that_contradict_the_others_are_named() -> None:
    (said,) = _disagreeing(["a", "b", "c"], np.array([0.1, 0.1, 0.0]), np.array([0.04, 0.02, 0.0]))
    assert said.startswith("in a (40% of the subject's area), the image and the other views disagree")


def test_masks_begun_with_networks_are_not_continued_without_them(scene: Path, tmp_path: Path) -> None:
    capture = open_capture(scene, held_out=[])
    assert isinstance(capture, FileCapture)
    _claim(capture, tmp_path / "masks", None, people=True)
    with pytest.raises(CaptureError, match=r"was begun with networks of people.*pip install --no-deps mediapipe"):
        make(scene, tmp_path / "masks")


def test_complete_masks_need_no_networks(scene: Path, masks: Path, tmp_path: Path) -> None:
    """A run that continues elsewhere takes masks that networks made."""
    shutil.copytree(masks, tmp_path / "masks")
    record = json.loads((tmp_path / "masks" / RECORD).read_text())
    (tmp_path / "masks" / RECORD).write_text(json.dumps(record | {"people": True}))
    assert make(scene, tmp_path / "masks").images == 0
