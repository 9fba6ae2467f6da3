"""Sound of a reel: images follow it, missing data stops both, viewers control its volume, and browsers may block it."""

import json
import statistics
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, Route

from splatreel.play.server import Server, serve
from tests.flashes import CLICKS
from tests.flashes import GOLDEN as SOUND
from tests.player.pages import PLAYER, expect_problems, let_frames_pass, open_player, wait_until
from tests.player.sync import listen, measured

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"
TRACK = f"{PLAYER}.soundtrack"
AUDIO = f"{TRACK}.audio"
HEARD = f"{AUDIO} && !{AUDIO}.paused && {AUDIO}.currentTime"
APART = f"Math.abs({AUDIO}.currentTime - {TRACK}.spatial.latency - {PLAYER}.currentTime)"


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serve(SOUND, port=0) as running:
        yield running


@pytest.fixture
def asked(page: Page) -> list[str]:
    """Return the names of the sound's files in the order of their requests."""
    names: list[str] = []
    page.on("request", lambda request: names.append(request.url.split("/")[-1]) if "/sound/" in request.url else None)
    return names


def untouched(page: Page, url: str, event: str, script: str) -> str:
    """Return a page's values before any user input. To a browser, a test's query counts as user input."""
    page.add_init_script(
        f"""addEventListener('DOMContentLoaded', () => customElements.whenDefined('splat-reel').then(() => setTimeout(() => {{
          const reel = {REEL};
          reel.addEventListener('{event}', async () => console.info(`outcome: ${{{script}}}`), {{ once: true }});
        }})))"""
    )
    with page.expect_console_message(lambda message: message.text.startswith("outcome")) as told:
        page.goto(url)
    return told.value.text


def play(page: Page) -> None:
    """Start playback by user input."""
    page.locator("splat-reel .start").click()
    page.wait_for_function(f"{HEARD} > 0.05 && {PLAYER}.currentTime > 0.05")


def test_pictures_follow_the_sound_over_a_loop_a_seek_and_another_rate(page: Page, server: Server):
    open_player(page, server)
    play(page)
    assert page.evaluate(f"{AUDIO}.preservesPitch") is True
    listen(page)
    page.wait_for_function("window.heard.length >= 3")
    page.evaluate(f"{PLAYER}.currentTime = 3.5")  # a click, and over the end
    page.wait_for_function("window.heard.length >= 5")
    page.evaluate(f"{PLAYER}.playbackRate = 1.5")
    page.wait_for_function("window.heard.length >= 8")
    page.wait_for_function("window.drawn.at(-1)[0] > window.heard[7] + 140")  # the picture of the last click is drawn
    found = measured(page, CLICKS)
    assert len(found.clock) >= 5, found
    interval = page.evaluate(f"{PLAYER}.resolution.interval")  # on a busy machine it is long
    assert abs(statistics.median(found.pictures)) < 40 + max(interval - 17, 0), (found, interval)
    assert statistics.median(map(abs, found.clock)) < 25, found


def test_a_stalled_group_pauses_the_sound_and_both_go_on_together(page: Page, server: Server):
    held: list[Route] = []
    page.route("**/groups/0001.safetensors", lambda route: held.append(route))
    open_player(page, server)
    play(page)
    page.wait_for_function(f"{PLAYER}.waiting && {AUDIO}.paused")
    stopped = page.evaluate(f"[{PLAYER}.currentTime, {AUDIO}.currentTime]")
    assert stopped == pytest.approx([1, 1], abs=0.3)
    let_frames_pass(page)
    assert page.evaluate(f"[{PLAYER}.currentTime, {AUDIO}.currentTime]") == stopped
    held[0].continue_()
    page.wait_for_function(f"{HEARD} > 1.4 && {PLAYER}.currentTime > 1.4 && {APART} < 0.1")


def test_missing_sound_makes_pictures_wait(page: Page, server: Server):
    held: list[Route] = []
    page.route("**/sound/0001.m4s", lambda route: held.append(route))
    open_player(page, server)
    play(page)
    page.evaluate("window.events = []")
    page.evaluate(f"for (const name of ['waiting', 'playing']) {REEL}.addEventListener(name, () => events.push(name))")
    page.evaluate(f"{PLAYER}.currentTime = 2.2")
    page.wait_for_function(f"{PLAYER}.waiting && !{PLAYER}.seeking && events.length === 1")
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(2.2)
    held[0].continue_()
    page.wait_for_function(f"!{PLAYER}.waiting && {HEARD} > 2.3 && {APART} < 0.1")
    assert page.evaluate("events") == ["waiting", "playing"]


def test_sound_is_downloaded_when_it_will_be_heard(page: Page, server: Server, asked: list[str]):
    open_player(page, server, "?autoplay=0&muted=1")
    page.locator("splat-reel .start").click()
    page.wait_for_function(f"{PLAYER}.currentTime > 0.1")
    assert page.evaluate(f"[{REEL}.muted, {AUDIO}]") == [True, None]
    assert asked == []
    page.locator("splat-reel canvas").press("m")
    page.wait_for_function(f"{HEARD} > 0")
    # Pictures may have passed the first piece before the sound came.
    wait_until(page, lambda: "0001.m4s" in asked)
    assert asked[0] == "init.mp4"
    assert sorted(asked) == sorted({*asked, "0001.m4s"}), "each file once"


def test_what_plays_by_itself_plays_in_silence_until_a_tap(page: Page, server: Server, asked: list[str]):
    said = untouched(page, server.url, "playing", "[reel.muted, reel.paused]")
    assert said == "outcome: true,false"
    page.wait_for_function(f"{PLAYER}.currentTime > 0.1")
    assert asked == []
    tap = page.locator("splat-reel").get_by_role("button", name="Tap for sound")
    tap.click()
    page.wait_for_function(f"{HEARD} > 0 && {APART} < 0.1")
    assert page.evaluate(f"{REEL}.muted") is False
    assert tap.is_hidden()


def test_a_script_may_not_play_sound_before_a_tap(page: Page, server: Server):
    attempts = "[await reel.play().catch(({ name }) => name), reel.paused, reel.muted]"
    again = "[await ((reel.muted = true), reel.play().then(() => 'plays')), reel.paused]"
    said = untouched(page, server.url + "?autoplay=0", "canplay", f"[{attempts}, {again}]")
    assert said == "outcome: NotAllowedError,true,false,plays,false"


def test_volume_and_muted_are_those_of_a_video(page: Page, server: Server):
    open_player(page, server)
    page.evaluate(f"window.changes = 0, {REEL}.addEventListener('volumechange', () => changes++)")
    assert page.evaluate(f"[{REEL}.volume, {REEL}.muted, {REEL}.defaultMuted]") == [1, False, False]
    page.evaluate(f"{REEL}.volume = 0.4, {REEL}.volume = 0.4, {REEL}.muted = true")
    assert page.evaluate("changes") == 2
    assert (
        page.evaluate(f"(() => {{ try {{ {REEL}.volume = 2 }} catch (error) {{ return error.name }} }})()")
        == "IndexSizeError"
    )
    controls = page.locator("splat-reel .bar")
    slider = controls.get_by_role("slider", name="Volume")
    assert slider.input_value() == "0"
    controls.get_by_role("button", name="Unmute").click()
    assert page.evaluate(f"[{REEL}.volume, {REEL}.muted]") == [0.4, False]
    slider.press("ArrowUp")
    assert page.evaluate(f"{REEL}.volume") == pytest.approx(0.45)
    assert slider.get_attribute("aria-valuetext") == "45 %"
    slider.press("Home")
    assert page.evaluate(f"[{REEL}.volume, {REEL}.currentTime]") == [0, 0]
    page.locator("splat-reel canvas").press("m")
    assert page.evaluate(f"[{REEL}.volume, {REEL}.muted]") == [1, False]


def test_a_silent_reel_has_no_controls_of_sound_and_a_phone_no_slider(
    browser: Browser, server: Server, golden_page: Page
):
    bar = golden_page.locator("splat-reel .bar")
    assert bar.get_by_role("button", name="Mute").is_hidden()
    assert bar.get_by_role("slider", name="Volume").is_hidden()
    golden_page.locator("splat-reel .start").click()
    golden_page.wait_for_function(f"{PLAYER}.currentTime > 0.1")
    assert golden_page.evaluate(f"[{AUDIO}, {TRACK}.placed]") == [None, False]
    context = browser.new_context(viewport={"width": 800, "height": 400}, has_touch=True, is_mobile=True)
    phone = context.new_page()
    open_player(phone, server)
    assert phone.locator("splat-reel .bar").get_by_role("button", name="Mute").is_visible()
    assert phone.locator("splat-reel .level").is_hidden()
    context.close()


@pytest.fixture
def golden_page(page: Page) -> Iterator[Page]:
    from tests.golden import GOLDEN

    with serve(GOLDEN, port=0) as silent:
        open_player(page, silent)
        yield page


def test_sound_ends_with_the_pictures(page: Page, server: Server):
    open_player(page, server, "?autoplay=0&loop=0")
    play(page)
    page.evaluate(f"{PLAYER}.currentTime = 3.5")
    page.wait_for_function(f"{PLAYER}.ended && {PLAYER}.paused && {AUDIO}.paused")
    assert page.evaluate(f"{AUDIO}.currentTime") == pytest.approx(4, abs=0.15)
    page.locator("splat-reel canvas").press("k")
    page.wait_for_function(f"{PLAYER}.currentTime > 0.1 && {PLAYER}.currentTime < 2 && {HEARD} && {APART} < 0.1")


def test_sound_pauses_where_nobody_sees_the_pictures(page: Page, server: Server):
    open_player(page, server)
    play(page)
    page.evaluate(f"{REEL}.style.marginTop = '1000vh'")
    page.wait_for_function(f"{AUDIO}.paused && !{PLAYER}.paused")
    page.evaluate(f"{REEL}.style.marginTop = ''")
    page.wait_for_function(f"{HEARD} && {PLAYER}.playback.advancing && {APART} < 0.1")


def test_sound_comes_from_its_place(page: Page, server: Server):
    open_player(page, server)
    play(page)
    panner = f"{TRACK}.spatial.panner"
    place = f"['X', 'Y', 'Z'].map((axis) => {panner}['position' + axis].value)"
    # It glides there.
    page.wait_for_function(f"{panner}?.positionX.value > 0.05 && Math.abs(Math.hypot(...{place}) - 1) < 0.05")
    page.evaluate(f"{PLAYER}.camera.orbit(2.6, 0), {PLAYER}.invalidate()")
    page.wait_for_function(f"{panner}.positionX.value < -0.05")  # on the other side now
    page.keyboard.press("Tab")  # controls with the focus stay
    page.locator("splat-reel").get_by_role("button", name="Settings").click()
    page.locator("splat-reel").get_by_role("switch", name="Spatial sound").click()
    page.wait_for_function(f"!{TRACK}.spatial.on && !{TRACK}.spatial.through && {HEARD} && {APART} < 0.1")


def test_a_browser_without_media_source_plays_one_file(page: Page, server: Server):
    page.add_init_script("delete window.MediaSource; delete window.ManagedMediaSource")
    open_player(page, server)
    play(page)
    page.evaluate(f"{PLAYER}.currentTime = 3")
    page.wait_for_function(f"{HEARD} > 3.1 && {APART} < 0.1")


def test_a_reel_whose_sound_is_gone_plays_in_silence_and_says_so(page: Page, server: Server):
    expect_problems(page, "404")
    page.route("**/sound/0000.m4s", lambda route: route.fulfill(status=404))
    open_player(page, server)
    page.locator("splat-reel .start").click()
    page.wait_for_function(f"{PLAYER}.currentTime > 0.1")
    assert "sound cannot be played" in page.locator("splat-reel .toast").inner_text()
    assert page.locator("splat-reel .mute").is_hidden()


def test_the_sound_of_a_live_reel_grows(page: Page, server: Server):
    whole = json.loads((SOUND / "manifest.json").read_text())
    early = whole | {"live": True, "frames": 102, "groups": whole["groups"][:2]}
    early["sound"] = whole["sound"] | {"segments": whole["sound"]["segments"][:1]}
    page.route("**/manifest.json", lambda route: route.fulfill(json=early))
    open_player(page, server, "?autoplay=0&loop=0")
    page.locator("splat-reel .play").click()
    page.wait_for_function(f"{HEARD} > 1")  # at its edge
    page.unroute("**/manifest.json")
    page.wait_for_function(f"{HEARD} > 2.3 && {APART} < 0.1")


def test_keys_turn_a_muted_reel_on_at_its_own_volume(page: Page, server: Server):
    open_player(page, server)
    page.locator("splat-reel canvas").focus()
    state = f"[{REEL}.volume, {REEL}.muted]"
    steps = [("ArrowDown", [1, True]), ("ArrowUp", [1, False]), ("ArrowDown", [0.95, False]), ("ArrowUp", [1, False])]
    page.evaluate(f"{REEL}.muted = true")
    for key, expected in steps:
        page.keyboard.press(key)
        assert page.evaluate(state) == [pytest.approx(expected[0]), expected[1]]
    page.evaluate(f"({REEL}.volume = 0, {REEL}.muted = true)")
    page.keyboard.press("ArrowUp")
    assert page.evaluate(state) == [pytest.approx(0.05), False]
    assert page.locator("splat-reel .toast").inner_text() == "Volume 5 %"
