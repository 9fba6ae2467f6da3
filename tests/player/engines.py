"""Functions of the tests of reels in other engines: their pages, their pixels, and what must hold in every engine."""

import io
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page

from tests.golden import PREDICTIVE
from tests.player.pages import add_file, expect_problems, wait_until

PLAYER = Path(__file__).parents[2] / "player"
HEIGHT, WIDTH = 120, 160
GREEN = np.array([0.0, 1.0, 0.0])


def write_site(folder: Path, name: str, built: str) -> Path:
    """Build a package of the player, and write its test page, its files and a reel into a folder.

    Args:
        folder: Folder to write.
        name: Name of the package, its page and its engine.
        built: Folder for the package's files, as the page names it.

    Returns:
        The folder with the builds of the engine.
    """
    engine = PLAYER / "node_modules" / name / "build"
    if shutil.which("npm") is None or not engine.is_dir():
        pytest.skip("needs node, and npm ci in player/")
    package = PLAYER / "packages" / name
    result = subprocess.run(["node", package / "build.mjs"], cwd=PLAYER, capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stdout + result.stderr
    shutil.copy(Path(__file__).parent / f"{name}.html", folder / "index.html")
    shutil.copytree(package / "dist", folder / built)
    shutil.copytree(PREDICTIVE, folder / "reel")
    return engine


def open_reel_in(page: Page, address: str) -> Page:
    """Open the page with a reel `reel`, seen by its start camera."""
    page.goto(address)
    page.wait_for_function("window.events")
    page.evaluate("async () => { window.reel = await openReel('reel/manifest.json'); reel.viewFromStart(camera); }")
    return page


def pixels_of(page: Page, script: str) -> np.ndarray:
    """Return the image [H, W, 3], 0..1, that a script resolves to."""
    data = np.array(page.evaluate(script), np.float32).reshape(HEIGHT, WIDTH, 4)
    return data[..., :3] / 255


def expect_meshes_to_hide_splats(page: Page) -> None:
    """Check that a plane hides the splats behind it, and is hidden by those before it."""
    alone = pixels_of(page, "picture(reel, 0.05)")
    front = pixels_of(page, "(window.move = addPlane(), move(1), pixels())")
    assert np.abs(front - GREEN).max() < 0.01
    behind = pixels_of(page, "(move(20), pixels())")
    assert np.abs(behind - alone)[..., [0, 2]].max() < 0.02, "green light adds to nothing but green"
    solid = alone.sum(-1) > 0.3
    assert solid.mean() > 0.1
    assert np.abs(behind - GREEN)[solid].max(-1).min() > 0.05
    middle = pixels_of(page, "(move(4), pixels())")
    assert np.abs(middle - behind).mean() > 0.01
    assert np.abs(middle - GREEN).mean() > 0.01


def expect_time_to_end(page: Page) -> None:
    """Play to the end."""
    page.evaluate("void reel.play()")  # its promise waits for a drawn frame, and only `until` draws
    page.evaluate("until(() => reel.ended)")
    assert page.evaluate("[reel.paused, reel.currentTime === reel.duration, events.includes('ended')]") == [True] * 3


def snippet_of(name: str) -> str:
    """Return the code of the section "Use" of an engine's document."""
    text = (PLAYER.parent / "docs" / f"{name}.md").read_text(encoding="utf-8")
    return text.split("## Use")[1].split("```js\n")[1].split("```")[0]


def expect_snippet_to_draw(page: Page, address: str, name: str) -> None:
    """Run the code of an engine's document as it stands, and wait for a picture of the reel."""
    document = (Path(__file__).parent / f"{name}.html").read_text(encoding="utf-8")
    imports = re.search(r'<script type="importmap">.*?</script>', document, re.S)
    assert imports
    add_file(
        page,
        "snippet.html",
        f'<link rel="icon" href="data:,">{imports[0]}<body><script type="module">{snippet_of(name)}</script>',
    )
    page.goto(f"{address}snippet.html")

    def is_shown() -> bool:
        with Image.open(io.BytesIO(page.screenshot())) as picture:
            colors = np.asarray(picture.convert("RGB")).reshape(-1, 3)
        return bool(colors.std() > 0.05 * 255) and len(np.unique(colors, axis=0)) > 500

    wait_until(page, is_shown)


def expect_errors_as_events(page: Page, address: str) -> None:
    """Open a reel that does not exist."""
    page.goto(address)
    page.wait_for_function("window.events")
    expect_problems(page, "404")
    message = page.evaluate("openReel('missing/manifest.json').then((reel) => reel.error.message)")
    assert "missing/manifest.json cannot be downloaded" in message
    assert page.evaluate("events") == ["error"]
