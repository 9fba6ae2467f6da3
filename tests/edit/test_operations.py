"""Operations by their names: values, colors, sound, edit lists and wrong arguments."""

import json
import wave
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import UsageError
from splatreel.edit.operations import OPERATIONS, apply_operations, read_edit_list
from splatreel.edit.reel_clip import ReelClip
from splatreel.play.timeline import open_reel
from tests.edit.clips import edit, make_image, psnr, write_reel
from tests.flashes import clicks

ROOT = Path(__file__).parent.parent.parent


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_reel(tmp_path_factory.mktemp("reel") / "reel", 2)


@pytest.mark.parametrize(
    ("operation", "gain"),
    [
        ("gain=0.5", (0.5, 0.5, 0.5)),
        ("gain=0.9,1,0.8", (0.9, 1, 0.8)),
        ("exposure=-1", (0.7297, 0.7297, 0.7297)),
        ("white=#ff8080", (0.6679, 1.3306, 1.3306)),
    ],
)
def test_colors_are_multiplied(reel: Path, tmp_path: Path, operation: str, gain: tuple[float, ...]) -> None:
    lit, original = edit(reel, tmp_path / "lit", operation), open_reel(reel)
    for frame in (0, 6.5, 9):
        assert psnr(make_image(lit, frame), make_image(original, frame) * gain) > 55
    assert (tmp_path / "lit" / "layers" / "0000.safetensors").read_bytes() == (
        reel / "layers" / "0000.safetensors"
    ).read_bytes()


def test_background_and_transparency(reel: Path, tmp_path: Path) -> None:
    blue = edit(reel, tmp_path / "blue", "crop=sphere:0,0,0,0.8", "background=#0000ff")
    assert blue.manifest.background == (0, 0, 1)
    np.testing.assert_allclose(make_image(blue, 0)[0, 0], (0, 0, 1), atol=1e-6)
    clear = edit(tmp_path / "blue", tmp_path / "clear", "background=transparent")
    assert clear.manifest.transparent
    assert json.loads((tmp_path / "clear" / "manifest.json").read_text())["transparent"] is True
    assert not edit(tmp_path / "clear", tmp_path / "white", "background=#ffffff").manifest.transparent


def test_sound_of_a_file_replaces_the_sound(reel: Path, tmp_path: Path) -> None:
    samples = clicks((0.5, 0.9), 3.0)
    with wave.open(str(tmp_path / "music.wav"), "wb") as file:
        file.setparams((1, 2, 48_000, 0, "NONE", ""))
        file.writeframes((samples * 32767).astype("<i2").tobytes())
    for text, shift in ((f"sound={tmp_path / 'music.wav'}", 0.0), (f"sound={tmp_path / 'music.wav'}@0.25", 0.25)):
        out = tmp_path / f"out{shift}"
        heard = edit(reel, out, text).sound
        assert heard is not None
        assert heard.position is None
        expected = np.zeros((48_000, 1), np.float32)
        expected[:] = samples[round(shift * 48_000) :][:48_000]
        assert np.corrcoef(heard.samples(0, 1.0)[:, 0], expected[:, 0])[0, 1] > 0.95
    late = edit(reel, tmp_path / "late", f"sound={tmp_path / 'music.wav'}@-0.5").sound
    assert late is not None
    assert np.abs(late.samples(0, 0.9)).max() < 0.05
    assert np.abs(late.samples(0.9, 0.2)).max() > 0.3
    assert edit(reel, tmp_path / "silent", "sound=none").sound is None


def test_sound_without_an_edit_of_time_is_copied(reel: Path, tmp_path: Path) -> None:
    edit(reel, tmp_path / "moved", "scale=2")
    for file in (reel / "sound").iterdir():
        assert (tmp_path / "moved" / "sound" / file.name).read_bytes() == file.read_bytes()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("blur=3", "no such operation. Choose one of cut, join"),
        ("cut", "write cut=A:B"),
        ("reverse=yes", "write reverse"),
        ("cut=5", "range A:B"),
        ("cut=5:5", "Choose frames from 0:12"),
        ("cut=0:99", "Choose frames from 0:12, which are 1.2 seconds"),
        ("cut=1.5:3", "whole number of frames"),
        ("cut=:", "range A:B"),
        ("fps=0", "from 0.001 to 1000"),
        ("fps=nan", "from 0.001 to 1000"),
        ("crop=ball:1", "Give box:x,y,z"),
        ("crop=box:0,0,0,1,1", "6 numbers"),
        ("crop=box:0,0,0,1,-1,1", "low corner of the box first"),
        ("crop=sphere:0,0,0,-1", "sizes above 0"),
        ("crop=sphere:0,0,zero,1", "Give a number"),
        ("remove=sphere:0,0,0,1@9:", None),
        ("remove=sphere:0,0,0,1@9", "range A:B"),
        ("min-opacity=2", "from 0 to 1"),
        ("min-cameras=4", "from 1 to 3"),
        ("min-cameras=1.5", "whole number"),
        ("max-size=0", "Give a number"),
        ("rotate=w,90", "as the axis"),
        ("rotate=0,0,0,90", "axis that is not zero"),
        ("rotate=90", "as the axis"),
        ("up=0,0,0", "axis that is not zero"),
        ("scale=-1", "Give a number"),
        ("distance=cam00,cam09,2", "'cam09' is not a camera; choose from cam00"),
        ("distance=cam00,2", "distance=CAMERA,CAMERA,METERS"),
        ("move=1,2", "3 numbers"),
        ("exposure=much", "from -8 to 8"),
        ("gain=0,1,1", "factors from 0.01 to 100"),
        ("white=#000000", "not so dark"),
        ("background=blue", "a color like #ffffff"),
        ("sound=nothing.wav", "Name a sound file, or none"),
        ("join=", "Name the folder of a reel"),
    ],
)
def test_wrong_arguments_are_explained(reel: Path, text: str, message: str | None) -> None:
    if message is None:
        apply_operations(ReelClip(reel), [text])
        return
    with pytest.raises(UsageError) as caught:
        apply_operations(ReelClip(reel), [text])
    assert message in str(caught.value)


def test_join_refuses_reels_of_another_scene(reel: Path) -> None:
    class Other(ReelClip):
        def __init__(self, location: str | Path) -> None:
            super().__init__(location)
            header = replace(self.outline.header, up=np.array([0.0, 0, 1]), antialias=False)
            self.outline = replace(self.outline, header=header)

    from splatreel.edit.joining import Joined

    with pytest.raises(UsageError, match="differ in their antialias, up direction"):
        Joined(ReelClip(reel), Other(reel))


def test_edit_lists_are_read(tmp_path: Path) -> None:
    file = tmp_path / "edits.json"
    file.write_text(json.dumps({"format": "splatreel-edit", "version": 1, "operations": ["cut=0:2", "reverse"]}))
    assert read_edit_list(file) == ["cut=0:2", "reverse"]
    for wrong, message in (
        ({"format": "splatreel-path"}, "is not an edit list"),
        ({"format": "splatreel-edit", "version": 2}, "has version 2"),
        ({"format": "splatreel-edit", "version": 1, "operations": [1]}, "not a list of texts"),
        ([1], "is not an edit list"),
    ):
        file.write_text(json.dumps(wrong))
        with pytest.raises(UsageError, match=message):
            read_edit_list(file)
    file.write_text("{")
    with pytest.raises(UsageError, match="is not JSON"):
        read_edit_list(file)


def test_page_of_the_documentation_lists_every_operation() -> None:
    page = (ROOT / "docs" / "editing.md").read_text()
    for operation in OPERATIONS.values():
        assert f"| `{operation.form}` | {operation.help} |" in page
