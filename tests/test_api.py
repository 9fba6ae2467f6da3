"""The Python API: public names, paths, cancelling, and messages without optional packages."""

import inspect
import io
import pydoc
import re
import subprocess
import sys
import threading
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import splatreel
import splatreel.readers
import splatreel.training
from splatreel.base.progress import Silent
from tests.golden import GOLDEN, PREDICTIVE
from tests.method.small import small
from toyroom.capture import make_capture

ROOT = Path(__file__).parent.parent
DOCUMENTS = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "reference").glob("*.md")),
]


def test_dir_lists_the_public_names_before_they_are_imported() -> None:
    code = "import splatreel; print(*dir(splatreel))"
    listed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert set(splatreel.__all__) <= set(listed)
    assert "importlib" not in listed


def test_help_describes_the_public_names() -> None:
    text = pydoc.plain(pydoc.render_doc(splatreel))
    for name in splatreel.__all__:
        assert re.search(rf"\b{name}\b.*[\n(]", text), name
    assert "Reconstruct a capture into OUT/reel" in text


def test_every_public_name_has_its_documentation() -> None:
    for name in splatreel.__all__:
        assert inspect.getdoc(getattr(splatreel, name)), name
    assert issubclass(splatreel.CancelledError, splatreel.SplatreelError)


@pytest.mark.parametrize(
    ("module", "call", "install"),
    [
        ("cv2", "reconstruct('room', 'out')", 'pip install "splatreel[recon]"'),
        ("torch", "open_reel(sys.argv[1])[0].to_torch()", "pip install torch"),
    ],
)
def test_missing_package_gives_the_message_of_the_command_line(module: str, call: str, install: str) -> None:
    code = f"""
import sys
sys.modules["{module}"] = None
import splatreel
try:
    splatreel.{call}
except splatreel.SplatreelError as error:
    print(error)
"""
    command = [sys.executable, "-c", code, str(PREDICTIVE)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert printed == f"the Python package {module!r} is needed and not installed. Run\n  {install}\n"


def test_rendered_images_are_within_0_and_1() -> None:
    values = [[0, 0, 2]], [[1, 0, 0, 0]], [[0.5] * 3], [0.99], [[[9.0, 9.0, 9.0]]]
    bright = splatreel.Gaussians(*(np.array(value, np.float32) for value in values))
    camera = splatreel.Camera("view", np.eye(4), np.array([[16, 0, 8], [0, 16, 8], [0, 0, 1]]), 16, 16)
    image = splatreel.render(bright, camera)
    assert image.max() == 1
    assert image.min() >= 0
    shown = splatreel.open_reel(GOLDEN).render(bright, camera)
    assert shown.max() == 1
    assert (shown * 255).astype(np.uint8)[8, 8].min() == 255


@pytest.mark.parametrize(
    "module", [splatreel, splatreel.readers, splatreel.training], ids=lambda module: module.__name__
)
def test_the_page_of_stable_names_lists_the_public_names(module: ModuleType) -> None:
    page = (ROOT / "docs" / "reference" / "index.md").read_text(encoding="utf-8")
    if module is splatreel:
        listed = re.findall(r"\[`(\w+)`\]\[", page.partition("| name |")[2].partition("\n\n")[0])
    else:
        entry = page.partition(f"[`{module.__name__}`]")[2].partition("\n- ")[0].partition(":")[2]
        listed = re.findall(r"`(\w+)`", entry)
    assert sorted(listed) == sorted(module.__all__)
    assert all(getattr(module, name).__doc__ for name in module.__all__)


class Stops(Silent):
    """Progress display that sets an event in the first stage."""

    def __init__(self) -> None:
        self.event = threading.Event()

    def stage(self, name: str, total: int, span: tuple[float, float] | None = None) -> None:
        self.event.set()


def test_cancel_stops_at_the_next_report(tmp_path: Path) -> None:
    room, stops = make_capture(tmp_path / "room", width=64, height=48, frames=2), Stops()
    with pytest.raises(splatreel.CancelledError, match="the same call continues"):
        splatreel.reconstruct(str(room), str(tmp_path / "out"), small(), progress=stops, cancel=stops.event)


@pytest.mark.slow
def test_a_cancelled_run_of_arrays_is_continued_by_the_same_arrays(tmp_path: Path) -> None:
    source = splatreel.open_capture(make_capture(tmp_path / "room", width=64, height=48, frames=3))
    images = source.read(0, source.frames, [camera.name for camera in source.cameras])
    config, out, stages = small(), tmp_path / "out", []

    class StopsLater(Stops):
        def stage(self, name: str, total: int, span: tuple[float, float] | None = None) -> None:
            stages.append(name)
            if len(stages) == 4:
                self.event.set()

    def capture(pixels: np.ndarray) -> splatreel.readers.Capture:
        return splatreel.capture_from_arrays(pixels, source.cameras, np.arange(3) / 10, held_out=source.held_out)

    stops = StopsLater()
    with pytest.raises(splatreel.CancelledError):
        splatreel.reconstruct(capture(images), out, config, progress=stops, cancel=stops.event)
    with pytest.raises(splatreel.SplatreelError, match="holds another reconstruction"):
        splatreel.reconstruct(capture(255 - images), out, config)
    splatreel.reconstruct(capture(images / 255), out, config)
    with splatreel.open_reel(out) as reel:
        assert (reel.frames, reel.fps) == (3, 10)
    assert splatreel.evaluate(out, capture(images), lpips_every=0).psnr > 10


def snippets() -> list[str]:
    """Return the Python examples of the documents, in their order."""
    return [
        code
        for document in DOCUMENTS
        for code in re.findall(r"```python\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL)
    ]


@pytest.mark.slow
def test_documented_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They run as they are written, on a tiny room and with few iterations."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("splatreel.api.preset", lambda name: small())
    make_capture(Path("room"), width=64, height=48, frames=4)
    found = sorted(snippets(), key=lambda code: "reconstruct(" not in code)
    assert len(found) >= 5
    for code in found:
        if "out/demo" in code:
            code = code.replace("out/demo", "out/room")
        printed = io.StringIO()
        monkeypatch.setattr(sys, "stdout", printed)
        exec(compile(code, "a document", "exec"), {})
    assert splatreel.open_reel("out/room").frames == 4
    assert splatreel.open_reel("out/arrays").frames == 4
