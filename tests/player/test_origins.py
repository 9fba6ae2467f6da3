"""The player from another origin, such as a CDN, and under the strict policies that docs/player.md gives."""

import base64
import hashlib
import re
from pathlib import Path

import pytest
from playwright.sync_api import ConsoleMessage, Page
from playwright.sync_api import Error as PlaywrightError

from splatreel.play.player_page import STATIC
from splatreel.play.server import serve
from tests.flashes import GOLDEN as SOUND
from tests.golden import GOLDEN, PREDICTIVE
from tests.player.hosts import host
from tests.player.pages import PLAYER, expect_problems, wait_until

pytestmark = pytest.mark.browser

DOCS = Path(__file__).parents[2] / "docs" / "player.md"
CORS = {"Access-Control-Allow-Origin": "*"}
PAGE = """<!doctype html><link rel="icon" href="data:," /><script type="module" src="{player}player.js"></script>
<splat-reel src="{reel}manifest.json" controls></splat-reel>"""


@pytest.fixture
def bypass_csp() -> bool:
    return False


def policies() -> list[str]:
    """Return the policies of the docs: for the player on the page's own origin, and from a CDN."""
    found = re.findall(r"^ +Content-Security-Policy: (.+)$", DOCS.read_text(), re.M)
    assert len(found) == 2
    return found


def test_the_docs_name_the_script_of_the_bundled_page():
    script = re.search(r"<script type=\"module\" data-early>(.*?)</script>", (STATIC / "index.html").read_text(), re.S)
    assert script
    digest = base64.b64encode(hashlib.sha256(script[1].encode()).digest()).decode()
    assert f"'sha256-{digest}'" in policies()[0], f"docs/player.md: the policy must name 'sha256-{digest}'"


def violations(page: Page) -> list[str]:
    """Return the violations of policies in pages and workers, from the console."""
    texts: list[str] = []

    def listen(message: ConsoleMessage) -> None:
        if re.search("Content Security Policy|Trusted", message.text):
            texts.append(message.text)

    page.on("console", listen)
    return texts


def wait(page: Page, expression: str) -> None:
    """Wait for a condition. Policies forbid `wait_for_function`."""
    wait_until(page, lambda: page.evaluate(expression))


def wait_for_picture(page: Page) -> None:
    wait(page, f"document.querySelector('splat-reel')?.player && ({PLAYER}.canPlay || {PLAYER}.error !== null)")
    assert page.evaluate(f"{PLAYER}.error?.message ?? null") is None


@pytest.mark.parametrize("reel", [GOLDEN, PREDICTIVE], ids=["h265", "predictive"])
def test_page_player_and_reel_on_three_origins(page: Page, tmp_path: Path, reel: Path):
    with host(STATIC, headers=CORS) as cdn, host(reel, headers=CORS) as data:
        policy = policies()[1].replace("https://cdn.example", cdn[:-1]).replace("https://reels.example", data[:-1])
        pages = {"/": PAGE.format(player=cdn, reel=data)}
        with host(tmp_path, pages, {"Content-Security-Policy": policy}) as site:
            forbidden = violations(page)
            page.goto(site)
            wait_for_picture(page)
            page.evaluate(f"{PLAYER}.currentTime = 0.3")
            wait(page, f"!{PLAYER}.seeking && !{PLAYER}.waiting")
            page.locator("splat-reel").get_by_role("button", name="Settings").click()
            page.locator("splat-reel").get_by_role("button", name="Camera path").click()
            page.locator("splat-reel .path-panel").wait_for()  # a module that is loaded when it is asked for
    assert forbidden == []


@pytest.mark.parametrize("reel", [GOLDEN, PREDICTIVE], ids=["h265", "predictive"])
def test_a_strict_policy_on_one_origin(page: Page, tmp_path: Path, reel: Path):
    (tmp_path / "player").symlink_to(STATIC)
    (tmp_path / "reel").symlink_to(reel)
    pages = {"/": PAGE.format(player="player/", reel="reel/")}
    with host(tmp_path, pages, {"Content-Security-Policy": policies()[0]}) as site:
        forbidden = violations(page)
        page.goto(site)
        wait_for_picture(page)
        page.locator("splat-reel").get_by_role("button", name="Settings").click()
        page.goto(f"{site}player/index.html?src=../reel/manifest.json")
        wait_for_picture(page)
    assert forbidden == []


@pytest.mark.parametrize("reel", [SOUND, PREDICTIVE], ids=["h265", "predictive"])
def test_the_server_s_own_policy(page: Page, reel: Path):
    """The page of `serve` plays its own reel and one on another host."""
    with serve(reel, port=0) as server, serve(GOLDEN, port=0, cors=True) as other:
        forbidden = violations(page)
        page.goto(f"{server.url}?autoplay=0")
        wait_for_picture(page)
        if reel is SOUND:
            page.locator("splat-reel .start").click()
            wait(page, f"{PLAYER}.soundtrack.audio?.currentTime > 0.1 && {PLAYER}.currentTime > 0.1")
        page.goto(f"{server.url}?src={other.url}reel/manifest.json")
        wait_for_picture(page)
    assert forbidden == []


def test_sound_under_a_strict_policy(page: Page, tmp_path: Path):
    (tmp_path / "player").symlink_to(STATIC)
    (tmp_path / "reel").symlink_to(SOUND)
    pages = {"/": PAGE.format(player="player/", reel="reel/")}
    with host(tmp_path, pages, {"Content-Security-Policy": policies()[0]}) as site:
        forbidden = violations(page)
        page.goto(site)
        wait_for_picture(page)
        page.locator("splat-reel .start").click()
        wait(page, f"{PLAYER}.soundtrack.audio?.currentTime > 0.1 && {PLAYER}.currentTime > 0.1")
    assert forbidden == []


TRUSTED_TYPES = "require-trusted-types-for 'script'; trusted-types splatreel 'allow-duplicates'"


@pytest.mark.parametrize("reel", [GOLDEN, PREDICTIVE], ids=["h265", "predictive"])
@pytest.mark.parametrize("policy", [f"{{strict}}; {TRUSTED_TYPES}", "require-trusted-types-for 'script'"])
def test_a_page_that_requires_trusted_types(page: Page, tmp_path: Path, reel: Path, policy: str):
    (tmp_path / "player").symlink_to(STATIC)
    (tmp_path / "reel").symlink_to(reel)
    pages = {"/": PAGE.format(player="player/", reel="reel/")}
    with host(tmp_path, pages, {"Content-Security-Policy": policy.format(strict=policies()[0])}) as site:
        forbidden = violations(page)
        page.goto(site)
        wait_for_picture(page)
        with pytest.raises(PlaywrightError, match="TrustedHTML"):
            page.evaluate("document.createElement('div').innerHTML = '<b></b>'")
        forbidden.clear()
        page.expected_problems = ("TrustedHTML",)  # type: ignore[attr-defined]
        element = page.locator("splat-reel")
        element.locator(".start").click()
        element.locator("canvas").press("?")
        element.get_by_role("dialog").get_by_text("Double click").wait_for()
        element.locator("canvas").press("Escape")
        for name, shown in (
            ("Camera path", ".path-panel"),
            ("Crop and clean", ".command"),
            ("Statistics", ".stats dt"),
        ):
            element.get_by_role("button", name="Settings").click()
            element.locator(".menu").get_by_text(name).click()
            element.locator(shown).first.wait_for()
        page.goto(f"{site}player/index.html?src=../reel/manifest.json")
        wait_for_picture(page)
    assert forbidden == []


def test_trusted_types_and_a_player_from_another_origin(page: Page, tmp_path: Path):
    with host(STATIC, headers=CORS) as cdn, host(PREDICTIVE, headers=CORS) as data:
        pages = {"/": PAGE.format(player=cdn, reel=data)}
        with host(tmp_path, pages, {"Content-Security-Policy": TRUSTED_TYPES}) as site:
            forbidden = violations(page)
            page.goto(site)
            wait_for_picture(page)
    assert forbidden == []


def test_without_leave_for_webassembly_it_decodes_in_javascript(page: Page, tmp_path: Path):
    expect_problems(page, "WebAssembly")
    (tmp_path / "player").symlink_to(STATIC)
    (tmp_path / "reel").symlink_to(PREDICTIVE)
    policy = policies()[0].replace(" 'wasm-unsafe-eval'", "")
    pages = {"/": PAGE.format(player="player/", reel="reel/")}
    with host(tmp_path, pages, {"Content-Security-Policy": policy}) as site:
        page.goto(site)
        wait_for_picture(page)
