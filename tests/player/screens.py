"""Every state of the player's controls, as pictures: `python -m tests.player.screens` (or `make golden`) takes them anew.

Look at what it wrote before it is committed. The scenes are the golden reels.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page

from splatreel.play.server import serve
from tests.golden import GOLDEN
from tests.player.pages import PLAYER, let_time_pass, wait_for_picture

SCREENS = Path(__file__).parent.parent / "data" / "screens"
REEL = "document.querySelector('splat-reel')"
SETTLE_MS = 200
"""Two pictures so far apart that are equal: nothing moves any more."""
MOST_PICTURES = 50
STATS = {"fps": 60, "points": 13579, "width": 480, "height": 320, "rendition": "high", "bitrate": 4.2e6}
STATS |= {"throughput": 25e6, "ahead": 7.5, "decodeMilliseconds": 21, "sortMilliseconds": 1.4}


def nothing(page: Page) -> None:
    pass


def begin(page: Page) -> None:
    """Wait for a complete image at a fixed time, in full resolution on any machine."""
    wait_for_picture(page)
    page.evaluate(f"{PLAYER}.resolution.quality = 'full'; {PLAYER}.currentTime = 0.2")
    page.wait_for_function(f"!{PLAYER}.seeking")


def again_and_again(page: Page, event: str) -> None:
    """Send an event to the image a few times per second, so that temporary messages stay on a slow machine."""
    page.evaluate(f"setInterval(() => {PLAYER}.canvas.dispatchEvent({event}), 300)")


def press(*keys: str) -> Callable[[Page], None]:
    def act(page: Page) -> None:
        begin(page)
        page.locator("splat-reel canvas").focus()
        for key in keys:
            page.keyboard.press(key)
        page.mouse.move(200, 100)

    return act


def play(page: Page) -> None:
    """Play with a stopped clock."""
    begin(page)
    page.evaluate(f"{PLAYER}.playbackRate = 0; {PLAYER}.play()")
    again_and_again(page, "new PointerEvent('pointermove', {bubbles: true, composed: true})")


def early(page: Page) -> None:
    """Show the poster until its explanation appears."""
    page.wait_for_function(f"{REEL}.shadowRoot.querySelector('img.poster').complete")
    page.locator("splat-reel .wait.long").wait_for()


def fresh(page: Page) -> None:
    wait_for_picture(page)
    page.evaluate(f"{PLAYER}.resolution.quality = 'full'; {PLAYER}.invalidate()")


def menu(page: Page) -> None:
    begin(page)
    page.evaluate(f"{PLAYER}.rendition = 'medium'")
    page.locator("splat-reel").get_by_role("button", name="Settings").click()
    page.locator("splat-reel .menu").wait_for()
    page.mouse.move(40, 40)


def statistics(page: Page) -> None:
    begin(page)
    page.evaluate(f"Object.defineProperty({PLAYER}, 'stats', {{value: {json.dumps(STATS)}}})")
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("i")


def wait(page: Page) -> None:
    """Keep the second group back."""
    wait_for_picture(page)
    page.evaluate(f"{PLAYER}.resolution.quality = 'full'; {PLAYER}.invalidate(); {PLAYER}.currentTime = 0.3")
    page.wait_for_function(f"{PLAYER}.waiting")
    page.evaluate(f"Object.defineProperty({PLAYER}, 'progress', {{value: 0.42}})")
    page.evaluate(f"{PLAYER}.dispatchEvent(new Event('progress'))")
    page.locator("splat-reel .wait.long").wait_for()  # it is explained


def error(page: Page) -> None:
    page.locator("splat-reel").get_by_role("alert").wait_for()


def detail(page: Page) -> None:
    error(page)
    page.locator("splat-reel").get_by_text("Details").click()
    # The port is another one every time.
    words = page.locator("splat-reel details div")
    words.evaluate("(words) => (words.textContent = words.textContent.replace(/:\\d+/, ':8080'))")


def stop(page: Page) -> None:
    """Let the second group fail."""
    fresh(page)
    page.evaluate(f"{PLAYER}.currentTime = 0.3")
    error(page)


def hint(page: Page) -> None:
    """Turn the wheel over an image that leaves it to the page."""
    begin(page)
    page.evaluate(f"{REEL}.setAttribute('gestures', 'cooperative')")
    page.mouse.move(60, 60)
    again_and_again(page, "new WheelEvent('wheel', {deltaY: 50, bubbles: true, composed: true, cancelable: true})")
    page.locator("splat-reel .gestures.shown").wait_for()


def opened(entry: str) -> Callable[[Page], None]:
    """Open a menu entry and return its dialog."""

    def act(page: Page) -> None:
        begin(page)
        reel = page.locator("splat-reel")
        reel.get_by_role("button", name="Settings").click()
        reel.locator(".menu").get_by_role("button", name=entry).click()
        reel.get_by_role("dialog").wait_for()
        # The port is another one every time.
        for area in reel.locator("textarea").all():
            area.evaluate("(area) => (area.value = area.value.replace(/:\\d+/g, ':8080'))")
        page.evaluate(f"{REEL}.shadowRoot.querySelector('.code path + path')?.remove()")
        page.mouse.move(4, 4)

    return act


def ask(page: Page) -> None:
    """Let the page ask for a reel, since there is none beside it."""
    page.locator("splat-reel .drop .choices").wait_for()


def path(page: Page) -> None:
    """Show a camera path of two views from the side."""
    begin(page)
    reel = page.locator("splat-reel")
    reel.get_by_role("button", name="Settings").click()
    reel.locator(".menu").get_by_role("button", name="Camera path").click()
    add = reel.get_by_role("button", name="Add this view")
    add.click()
    page.evaluate(f"{PLAYER}.camera.orbit(-0.6, 0.1)")
    add.click()
    page.evaluate(f"{PLAYER}.camera.orbit(0.3, 0.2); {PLAYER}.camera.zoom(1.4); {PLAYER}.invalidate()")
    page.evaluate(f"{REEL}.shadowRoot.activeElement.blur()")
    page.mouse.move(4, 4)


def walk(page: Page) -> None:
    """Walk, and let the hint go."""
    begin(page)
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("g")
    page.locator("splat-reel .walk").wait_for()
    page.wait_for_function(f"!{REEL}.shadowRoot.querySelector('.toast').matches('.shown')")


def thumbnail(page: Page) -> None:
    begin(page)
    track = page.locator("splat-reel .seek").bounding_box()
    assert track is not None
    page.mouse.move(track["x"] + 0.7 * track["width"], track["y"] + track["height"] / 2)
    page.locator("splat-reel .thumbnail img").wait_for()


def described(page: Page) -> None:
    """Give the reel a description and thumbnails, sand on blue."""
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    manifest |= {"title": "A toy train on its round", "author": "Ada Example", "licence": "CC BY 4.0"}
    manifest |= {"description": "Filmed on a Sunday with eight phones.\nThe engine is older than its driver."}
    manifest["thumbnails"] = {"width": 160, "height": 90, "columns": 1, "rows": 1, "seconds": 1, "count": 1}
    out = io.BytesIO()
    Image.new("RGB", (160, 90), (80, 130, 200)).save(out, "PNG")
    digest = hashlib.sha256(out.getvalue()).hexdigest()
    manifest["thumbnails"]["sheets"] = [{"uri": "thumbnails.png", "bytes": len(out.getvalue()), "sha256": digest}]
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))
    page.route("**/thumbnails.png", lambda route: route.fulfill(content_type="image/png", body=out.getvalue()))


def gone_second_group(page: Page) -> None:
    page.route("**/groups/0001.safetensors", lambda route: route.fulfill(status=404, body="not here"))


def no_second_group(page: Page) -> None:
    page.route("**/groups/0001.safetensors", lambda route: None)


def no_files(page: Page) -> None:
    for files in ("groups", "layers"):
        page.route(f"**/{files}/*", lambda route: None)


def no_reel(page: Page) -> None:
    page.route("**/reel/manifest.json", lambda route: route.fulfill(status=404, body="not here"))


def live_reel(page: Page) -> None:
    manifest = json.loads((GOLDEN / "manifest.json").read_text()) | {"live": True}
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))


def renditions(page: Page) -> None:
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    for group in manifest["groups"]:
        file = {name: group[name] for name in ("bytes", "sha256", "points")}
        group["renditions"] = {name: file | {"uri": f"{name}/{Path(group['uri']).name}"} for name in ("medium", "low")}
    named = re.compile(r"/(medium|low)/(\w+\.safetensors)$")
    page.route(named, lambda route: route.fulfill(path=GOLDEN / "groups" / route.request.url.rpartition("/")[2]))
    total = sum(group["bytes"] for group in manifest["groups"])
    manifest["renditions"] = [{"name": name, "bytes": total} for name in ("high", "medium", "low")]
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))


def headset(page: Page) -> None:
    there = "{value: {isSessionSupported: async (mode) => mode === 'immersive-vr'}}"
    page.add_init_script(f"Object.defineProperty(navigator, 'xr', {there})")


def augmented(page: Page) -> None:
    there = "{value: {isSessionSupported: async () => true}}"
    page.add_init_script(f"Object.defineProperty(navigator, 'xr', {there})")


def poster() -> str:
    """Return an image unlike the reel: blue above, sand below."""
    rows = np.linspace(0, 1, 32)[:, None, None]
    colors = (1 - rows) * np.array([80, 130, 200]) + rows * np.array([220, 190, 140])
    out = io.BytesIO()
    Image.fromarray(np.broadcast_to(colors, (32, 48, 3)).astype(np.uint8)).save(out, "PNG")
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode().replace("+", "%2B")


@dataclass(frozen=True)
class Screen:
    """A state of the page: its address, actions before and after it opens, its size, colors and screen."""

    act: Callable[[Page], None]
    before: Callable[[Page], None] = nothing
    query: str = "?autoplay=0"
    size: tuple[int, int] = (480, 320)
    scheme: str = "dark"
    forced: bool = False
    touch: bool = False
    lacks: bool = False
    """Files that the player goes on waiting for."""


PORTRAIT, LANDSCAPE = (360, 640), (640, 360)
SMALL, TINY = (200, 120), (100, 60)
"""Embeds in a page's column or list."""


GIVEN = "?autoplay=0&src=reel/manifest.json"

STATES = {
    "start": Screen(fresh),
    "paused": Screen(begin),
    "playing": Screen(play),
    "menu": Screen(menu, renditions, size=(480, 520)),
    "menu-light": Screen(menu, size=(480, 520), scheme="light"),
    "help": Screen(press("?"), size=(900, 520)),
    "statistics": Screen(statistics),
    "statistics-light": Screen(statistics, scheme="light"),
    "waiting": Screen(wait, no_second_group, lacks=True),
    "error": Screen(error, no_reel, query=GIVEN),
    "error-light": Screen(error, no_reel, query=GIVEN, scheme="light"),
    "live": Screen(begin, live_reel),
    "poster": Screen(early, no_files, query=f"?autoplay=0&poster={poster()}", lacks=True),
    "headset": Screen(begin, headset),
    "narrow": Screen(begin, headset, size=(320, 480)),
    "narrow-menu": Screen(menu, renditions, size=(320, 480)),
    "narrow-help": Screen(press("?"), size=(320, 480)),
    "narrow-error": Screen(error, no_reel, query=GIVEN, size=(320, 240)),
    "small": Screen(fresh, size=SMALL),
    "small-menu": Screen(menu, renditions, size=SMALL),
    "small-error": Screen(stop, gone_second_group, size=SMALL),
    "tiny": Screen(begin, size=TINY),
    "tiny-error": Screen(error, no_reel, query=GIVEN, size=TINY),
    "error-detail": Screen(detail, no_reel, query=GIVEN),
    "stopped": Screen(stop, gone_second_group),
    "hint": Screen(hint),
    "thumbnail": Screen(thumbnail, described),
    "about": Screen(opened("About this reel"), described),
    "share": Screen(opened("Share"), described, size=(800, 520)),
    "share-light": Screen(opened("Share"), described, size=(800, 520), scheme="light"),
    "ask": Screen(ask, no_reel, scheme="light"),
    "path": Screen(path, size=(640, 480)),
    "phone-path": Screen(path, size=PORTRAIT, scheme="light", touch=True),
    "phone-augmented": Screen(begin, augmented, size=PORTRAIT, touch=True),
    "phone-walk": Screen(walk, size=PORTRAIT, touch=True),
    "phone": Screen(begin, live_reel, size=PORTRAIT, touch=True),
    "phone-menu": Screen(menu, described, size=PORTRAIT, touch=True),
    "phone-help": Screen(press("?"), size=PORTRAIT, touch=True),
    "phone-share": Screen(opened("Share"), size=PORTRAIT, scheme="light", touch=True),
    "phone-error": Screen(error, no_reel, query=GIVEN, size=PORTRAIT, touch=True),
    "landscape": Screen(begin, headset, size=LANDSCAPE, touch=True),
    "landscape-menu": Screen(menu, renditions, size=LANDSCAPE, scheme="light", touch=True),
    "forced": Screen(begin, live_reel, forced=True),
    "forced-menu": Screen(menu, renditions, size=(480, 560), forced=True),
    "forced-share": Screen(opened("Share"), size=(800, 520), scheme="light", forced=True),
    "forced-error": Screen(detail, no_reel, query=GIVEN, forced=True),
}


def take(browser: Browser, url: str, screen: Screen) -> np.ndarray:
    """Take a picture of a state in which nothing moves, [H, W, 3] bytes."""
    width, height = screen.size
    page = browser.new_page(
        viewport={"width": width, "height": height},
        color_scheme="light" if screen.scheme == "light" else "dark",
        reduced_motion="reduce",
        forced_colors="active" if screen.forced else "none",
        has_touch=screen.touch,
        is_mobile=screen.touch,
        bypass_csp=True,  # it forbids the `eval` by which this waits
    )
    screen.before(page)
    page.goto(url + screen.query)
    page.wait_for_function(f"{REEL}?.shadowRoot")
    screen.act(page)
    if not screen.lacks:
        page.wait_for_function(f"!{PLAYER}?.busy")
    redraw(page)
    shot = settled(page)
    page.close()
    return shot


def redraw(page: Page) -> None:
    """Draw the image again, if there is one, from all loaded files."""
    page.evaluate(f"{PLAYER}?.addEventListener('drawn', () => (window.drawnAnew = true), {{once: true}})")
    page.evaluate(f"{PLAYER}?.invalidate()")
    page.wait_for_function(f"!{PLAYER}?.canPlay || window.drawnAnew")


def settled(page: Page) -> np.ndarray:
    """Return a screenshot of the page once it stops changing, [H, W, 3] bytes."""
    last = None
    for _ in range(MOST_PICTURES):
        shot = page.screenshot(animations="disabled", caret="hide")
        if shot == last:
            return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))
        last = shot
        let_time_pass(page, SETTLE_MS)
    raise AssertionError(f"the page still changes after {MOST_PICTURES} pictures")


def text_width(browser: Browser) -> float:
    """Return the width of a line in the controls' font, pixels. It shows whether this machine has the fonts of the stored pictures."""
    page = browser.new_page()
    line = "Fly through the cameras 0123456789 Mbit/s"
    font = "500 13px system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif"
    measure = "Object.assign(document.createElement('canvas').getContext('2d'), {font}).measureText(line).width"
    width = page.evaluate(f"([font, line]) => {measure}", [font, line])
    page.close()
    return round(width, 2)


def main() -> None:
    from playwright.sync_api import sync_playwright

    from tests.player.conftest import FLAGS

    path = next(p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n)))
    SCREENS.mkdir(exist_ok=True)
    with serve(GOLDEN, port=0) as server, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=FLAGS)
        for name, screen in STATES.items():
            picture = Image.fromarray(take(browser, server.url, screen))
            picture.save(SCREENS / f"{name}.webp", quality=95, method=6)
            print(f"{name}: {picture.width} x {picture.height}")
        (SCREENS / "font.json").write_text(json.dumps({"text_width": text_width(browser)}) + "\n")
        browser.close()


if __name__ == "__main__":
    main()
