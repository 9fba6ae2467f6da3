"""<splat-reel> has the states, events, promises and errors of HTMLMediaElement."""

import json

import pytest
from playwright.sync_api import Page, Route

from splatreel.play.server import Server
from splatreel.play.timeline import open_reel
from tests.golden import GOLDEN
from tests.player.pages import expect_problems, let_frames_pass, wait_until

pytestmark = pytest.mark.browser

EMBED = """<!doctype html><body><script type="module">
import { SplatReelElement } from "./player.js";
const r = window.r = new SplatReelElement();
const seen = window.seen = [];
const names = "emptied loadstart loadedmetadata loadeddata canplay play playing waiting seeking seeked error";
for (const name of names.split(" ")) r.addEventListener(name, () => seen.push(name));
r.style.width = "240px";
document.body.append(r);
window.outcome = (promise) => promise.then(() => "resolved", (error) => error.name);
window.blank = () => getComputedStyle(r.shadowRoot.querySelector("canvas")).opacity === "0";
</script>"""


@pytest.fixture
def embed(page: Page, server: Server) -> Page:
    """Open a page with an element `r` without a reel, and `seen`, its events."""
    page.route("**/embed.html", lambda route: route.fulfill(content_type="text/html", body=EMBED))
    page.goto(server.url + "embed.html")
    page.wait_for_function("window.r")
    return page


def opened(page: Page) -> None:
    page.evaluate("r.src = 'reel/manifest.json'")
    page.wait_for_function("r.readyState === 4")


def test_the_element_has_the_manners_of_a_video(embed: Page, server: Server):
    page = embed
    page.evaluate("r.addEventListener('canplay', () => { r.currentTime = 0.1; }, { once: true })")
    page.evaluate("r.src = 'reel/manifest.json'")
    page.wait_for_function("seen.includes('seeked') && r.readyState === 4")
    names = ["loadstart", "loadedmetadata", "loadeddata", "canplay", "seeking", "seeked"]
    assert page.evaluate("seen") == names, "nothing plays, so nothing says so"
    state = page.evaluate(
        "[r.paused, r.duration, r.currentTime, r.buffered.end(0), r.readyState, r.error, r.currentSrc, r.camera.width]"
    )
    duration = pytest.approx(open_reel(GOLDEN).duration)
    assert state == [True, duration, 0.1, duration, 4, None, f"{server.url}reel/manifest.json", 240]
    assert page.evaluate("r.play().then(() => [r.paused, seen.slice(6)])") == [False, ["play", "playing"]]
    assert page.evaluate("(r.pause(), r.currentTime)") > 0.1
    assert page.evaluate("(() => { seen.length = 0; r.currentTime = 0; return outcome(r.play()); })()") == "resolved"
    assert page.evaluate("seen")[-1] == "playing"


def test_without_a_reel_play_is_refused_and_nothing_waits(embed: Page):
    page = embed
    assert page.evaluate("outcome(r.play())") == "NotSupportedError"
    assert page.evaluate("[r.networkState, r.readyState, r.paused, r.currentSrc]") == [0, 0, True, ""]
    page.evaluate("r.controls = true")
    let_frames_pass(page)
    assert page.locator("splat-reel .wait").is_hidden()


def test_a_reel_that_is_taken_away_leaves_nothing(embed: Page):
    page = embed
    opened(page)
    page.wait_for_function("!blank()")
    page.evaluate(
        "r.currentTime = 0.2; r.playbackRate = 0.1; outcome(r.play()); seen.length = 0; r.removeAttribute('src')"
    )
    assert page.evaluate("[r.readyState, r.networkState, r.currentTime, r.paused, blank()]") == [0, 0, 0, True, True]
    assert page.evaluate("seen") == ["emptied"]
    assert page.evaluate("Number.isNaN(r.duration)")


def test_promises_of_play_are_settled(embed: Page):
    page = embed
    held: list[Route] = []
    page.route("**/groups/*", lambda route: held.append(route))
    page.evaluate("r.src = 'reel/manifest.json'")
    page.wait_for_function("r.readyState === 1")
    assert page.evaluate("(() => { const p = outcome(r.play()); r.pause(); return p; })()") == "AbortError"
    assert page.evaluate("(() => { const p = outcome(r.play()); r.load(); return p; })()") == "AbortError"
    assert page.evaluate("r.paused")
    page.evaluate("void (window.end = outcome(r.play()))")
    wait_until(page, lambda: held)
    let_frames_pass(page)
    assert "playing" not in page.evaluate("seen")
    page.unroute("**/groups/*")
    for route in held:
        route.continue_()
    assert page.evaluate("end.then((how) => r.error?.message ?? how)") == "resolved"
    assert page.evaluate("seen").count("playing") == 1


def test_errors_are_states_too(embed: Page):
    page = embed
    expect_problems(page, "404")
    page.evaluate("r.src = 'nowhere/manifest.json'; void (window.end = outcome(r.play()))")
    assert page.evaluate("end") == "NotSupportedError"
    assert page.evaluate("[r.networkState, r.error.message.includes('404')]") == [3, True]
    assert page.evaluate("outcome(r.play())") == "NotSupportedError"
    opened(page)
    assert page.evaluate("[r.networkState, r.error]") == [1, None]


def test_numbers_that_are_none_are_refused(embed: Page):
    page = embed
    opened(page)
    calls = ["r.currentTime = NaN", "r.currentTime = Infinity", "r.playbackRate = NaN", "r.playbackRate = -Infinity"]
    calls += [
        "r.camera = {viewmat: [1, 2, 3]}",
        "r.camera = {viewmat: Array(16).fill(NaN)}",
        "r.camera = {viewmat: Array(16).fill(1)}",
    ]
    for call in calls:
        name, message = page.evaluate(
            f"(() => {{ try {{ {call}; return ['', '']; }} catch (e) {{ return [e.name, e.message]; }} }})()"
        )
        assert name == "TypeError", call
        assert "must h" in message or "must be a finite number" in message
    still = "r.camera.viewmat"
    poses = [f"0, {{K: [1, 2], viewmat: {still}}}", f"0, {{K: Array(9).fill(NaN), viewmat: {still}}}"]
    poses += ["0, {K: r.camera.K, viewmat: [1]}", f"NaN, {{K: r.camera.K, viewmat: {still}}}"]
    for pose in poses:
        assert page.evaluate(f"outcome(r.renderAt({pose}, 32, 32))") == "TypeError"
    assert page.evaluate("outcome(r.renderAt(0, r.camera, NaN, 32))") == "TypeError"
    assert page.evaluate("[r.currentTime, r.playbackRate, r.camera.viewmat.every(Number.isFinite)]") == [0, 1, True]


def test_a_manifest_that_stalls_is_asked_for_again(embed: Page):
    page = embed
    asked: list[Route] = []

    def answer(route: Route) -> None:
        asked.append(route)
        if len(asked) > 1:
            route.continue_()

    page.route("**/reel/manifest.json", answer)
    page.clock.install()
    page.evaluate("r.src = 'reel/manifest.json'")
    wait_until(page, lambda: asked)
    page.clock.run_for(8100)
    assert "no data arrived" in page.evaluate("r.player.notice")
    page.clock.run_for(1000)
    page.clock.resume()
    page.wait_for_function("r.readyState >= 2")
    assert len(asked) == 2


@pytest.mark.parametrize(
    "link",
    [
        "t=NaN&view=NaN,0,0,1,0,0,0,4",
        "t=1e30&view=1e30,0,0,1,0,0,0,4",
        "t=-5&view=0,0,-900,1,0,0,0,4",
        "t=0&view=0,9,-4,1,0,0,0,4",
        "t=0&view=0,0,-4,1,0,0,0,1e30",
    ],
)
def test_a_link_to_nowhere_opens_at_the_start_view(embed: Page, link: str):
    page = embed
    page.evaluate(f"location.hash = {json.dumps(link)}; r.setAttribute('share', '')")
    opened(page)
    assert page.evaluate("r.camera.viewmat") == pytest.approx(list(open_reel(GOLDEN).manifest.camera.viewmat.ravel()))
    assert 0 <= page.evaluate("r.currentTime") <= page.evaluate("r.duration")


def test_a_link_to_a_view_opens_there(embed: Page):
    page = embed
    page.evaluate("location.hash = 't=0.2&view=0.5,-0.2,-3,1,0,0,0,3'; r.setAttribute('share', '')")
    opened(page)
    assert page.evaluate("[r.currentTime, r.camera.viewmat[3]]") == pytest.approx([0.2, -0.5])


def test_a_live_reel_that_goes_round_fades_into_its_last_group(embed: Page):
    """The first frames of the last group are faded from the group before, in the order of these frames."""
    page = embed
    manifest = json.loads((GOLDEN / "manifest.json").read_text()) | {"live": True}
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))
    page.evaluate("r.loop = true")
    opened(page)
    page.evaluate("""() => {
      const { stage, clock } = r.player;
      window.faults = [];
      window.rounds = 0;
      let last = 0;
      const { renderer } = stage;
      const draw = renderer.draw.bind(renderer);
      renderer.draw = (scene, weight, view) => {
        const { group, frame } = scene.current;
        if (frame < last) window.rounds++;
        last = frame;
        if (group === 1 && frame < clock.manifest.overlap && !scene.previous) faults.push(['no fade', frame]);
        if (frame < stage.scene.current.frame) faults.push(['order of a later frame', frame, stage.scene.current.frame]);
        draw(scene, weight, view);
      };
    }""")
    page.evaluate("r.playbackRate = 0.5; r.play()")
    page.wait_for_function("rounds >= 3")
    assert page.evaluate("faults") == []


def test_time_that_runs_backwards_is_drawn(embed: Page):
    """A camera path may run backwards. The sort order is then always that of a later frame."""
    page = embed
    opened(page)
    page.evaluate("r.currentTime = 0.39")
    page.wait_for_function("!r.seeking")
    drawn = page.evaluate("""() => new Promise((resolve) => {
      const { stage, playback } = r.player;
      const { renderer } = stage;
      const draw = renderer.draw.bind(renderer);
      const drawn = [];
      renderer.draw = (scene, weight, view) => {
        drawn.push(6 * scene.current.group + scene.current.frame);
        draw(scene, weight, view);
      };
      let time = 0.39;
      const step = () => {
        time -= 0.005;
        playback.scrub(time);
        if (time > 0.05) requestAnimationFrame(step);
        else resolve(drawn);
      };
      step();
    })""")
    assert len({round(frame, 2) for frame in drawn}) > 8
    assert drawn[-1] < 4
