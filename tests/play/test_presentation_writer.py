"""Words, posters and thumbnails, put into reels as they are written."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base import atomic
from splatreel.base.errors import ReelError
from splatreel.codec.inspection import verify_reel
from splatreel.codec.writer import ReelWriter
from splatreel.play.presentation_writer import PresentationWriter, jpeg_within
from splatreel.play.timeline import open_reel
from tests.codec.reels import new_group, new_writer, points
from tests.files import contents


def add_groups(writer: ReelWriter, numbers: range, present: PresentationWriter) -> None:
    """20 static points born at the first; every group has two frames of its own."""
    for index in numbers:
        if index == 0:
            writer.add_layer(0, 0, points(20))
        writer.add_group(new_group(index, 15, 20))
        present(writer, index)


def complete(writer: ReelWriter, present: PresentationWriter) -> None:
    present(writer, None)
    writer.finish()


def test_poster_is_written_with_first_group(tmp_path: Path) -> None:
    writer = new_writer(tmp_path)
    add_groups(writer, range(1), PresentationWriter({"title": "Balls"}))
    manifest = open_reel(tmp_path).manifest
    poster = manifest.presentation.poster
    assert manifest.live
    assert manifest.presentation.title == "Balls"
    assert poster is not None
    data = (tmp_path / poster.asset.uri).read_bytes()
    assert len(data) == poster.asset.bytes <= 25_000
    image = Image.open(io.BytesIO(data))
    assert (image.format, image.size, image.info.get("progressive")) == ("JPEG", (960, 720), 1)
    assert image.size == (poster.width, poster.height)
    reel = open_reel(tmp_path)
    truth = reel.render(reel.at(0), manifest.camera.resized(960, 720)).clip(0, 1)
    assert -10 * np.log10(np.mean((np.asarray(image) / 255 - truth) ** 2)) > 28


def test_interrupted_presentation_run_resumes_to_same_reel(tmp_path: Path) -> None:
    present = PresentationWriter({"author": "Somebody"})
    add_groups(writer := new_writer(tmp_path / "whole"), range(3), present)
    complete(writer, present)
    add_groups(new_writer(tmp_path / "cut"), range(1), PresentationWriter())
    (tmp_path / "cut" / "poster.jpg").unlink()
    writer = new_writer(tmp_path / "cut", resume=True)
    add_groups(writer, range(1, 3), present)
    present(writer, None)  # cut off here, before it was declared complete
    complete(new_writer(tmp_path / "cut", resume=True), PresentationWriter())
    assert contents(tmp_path / "cut") == contents(tmp_path / "whole")
    assert verify_reel(tmp_path / "cut").strangers == []


def test_existing_poster_and_thumbnails_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_groups(writer := new_writer(tmp_path), range(2), PresentationWriter())
    complete(writer, PresentationWriter())
    before = contents(tmp_path)
    monkeypatch.setattr("splatreel.play.timeline.Timeline.render", lambda *_: 1 / 0)
    complete(new_writer(tmp_path, resume=True), PresentationWriter())
    assert contents(tmp_path) == before


def test_presentation_changes_given_texts_only(tmp_path: Path) -> None:
    add_groups(writer := new_writer(tmp_path), range(1), PresentationWriter({"title": "One", "licence": "CC0-1.0"}))
    complete(writer, PresentationWriter({"title": "Two"}))
    found = open_reel(tmp_path).manifest.presentation
    assert (found.title, found.licence, found.author) == ("Two", "CC0-1.0", "")
    with pytest.raises(ReelError, match="title of 201 characters"):
        PresentationWriter({"title": "x" * 201})(writer, None)


def test_thumbnails_show_their_times(tmp_path: Path) -> None:
    add_groups(writer := new_writer(tmp_path), range(4), PresentationWriter())
    complete(writer, PresentationWriter())
    reel = open_reel(tmp_path)
    found = reel.manifest.presentation.thumbnails
    assert found is not None
    assert (found.count, found.columns, found.rows, found.seconds) == (5, 5, 1, 0.2), "0.9 s at 10 frames a second"
    sheet = np.asarray(Image.open(tmp_path / found.sheets[0].uri))
    assert sheet.shape == (found.height, 5 * found.width, 3) == (84, 560, 3)
    assert found.sheets[0].bytes < 10_000
    camera = reel.manifest.camera.resized(found.width, found.height)
    for index in range(5):
        image = sheet[:, index * found.width : (index + 1) * found.width] / 255
        errors = [np.abs(image - reel.render(reel.at(t * found.seconds), camera)).mean() for t in range(5)]
        assert np.argmin(errors) == index


def test_long_reel_has_thumbnail_sheets_of_five_minutes(tmp_path: Path) -> None:
    """Ten minutes at a frame every two seconds: an image each ten seconds, 30 a sheet, the last one not full."""
    writer = new_writer(tmp_path, fps=0.5)
    writer.add_layer(0, 0, points(20))
    writer.add_group(new_group(0, 2, 20, frames=310))
    complete(writer, PresentationWriter())
    found = open_reel(tmp_path).manifest.presentation.thumbnails
    assert found is not None
    assert (found.seconds, found.count, found.columns, found.rows, len(found.sheets)) == (10, 62, 6, 5, 3)
    sizes = {Image.open(tmp_path / sheet.uri).size for sheet in found.sheets}
    assert sizes == {(6 * found.width, 5 * found.height)}
    assert sum(sheet.bytes for sheet in found.sheets) < 110_000


def test_new_groups_remove_old_thumbnails(tmp_path: Path) -> None:
    add_groups(writer := new_writer(tmp_path), range(2), PresentationWriter())
    complete(writer, PresentationWriter())
    add_groups(writer := new_writer(tmp_path, resume=True), range(2, 3), PresentationWriter())
    assert writer.manifest.presentation.thumbnails is None
    assert not list(tmp_path.glob("thumbnails/*"))


def test_jpeg_quality_decreases_until_size_fits() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (96, 128, 3), np.uint8)
    fine, coarse = jpeg_within(noise, 10**6), jpeg_within(noise, 8_000)
    assert len(coarse) <= 8_000 < len(fine)


def test_oversized_poster_is_downscaled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatreel.play.presentation_writer.POSTER_BYTES", 4_000)
    add_groups(writer := new_writer(tmp_path), range(1), PresentationWriter())
    poster = writer.manifest.presentation.poster
    assert poster is not None
    assert (poster.width, poster.height) == (640, 480)


def test_killed_edit_resumes_to_same_reel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    present = PresentationWriter({"title": "Balls"})

    def run(folder: Path) -> None:
        writer = new_writer(folder, resume=True)
        published = len(writer.manifest.groups)
        if published:
            present(writer, published - 1)
        add_groups(writer, range(published, 2), present)
        complete(writer, present)

    run(tmp_path / "whole")
    writes, first = 0, atomic.write_bytes

    def write(path: Path, data: bytes) -> None:
        nonlocal writes
        writes += 1
        if writes == fatal:
            raise KeyboardInterrupt
        first(path, data)

    monkeypatch.setattr("splatreel.codec.writer.write_bytes", write)
    for fatal in range(1, 30):
        writes = 0
        folder = tmp_path / str(fatal)
        try:
            run(folder)
        except KeyboardInterrupt:
            run(folder)
        assert contents(folder) == contents(tmp_path / "whole"), f"killed at write {fatal}"
        if writes < fatal:
            break
    assert 8 < fatal < 29, "every write was tried"
