"""Hands, thumbsticks and augmented reality with a simulated headset. Each picture is compared with the CPU's from the same place."""

import base64

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server
from splatreel.play.timeline import open_reel
from splatreel.scene.camera import Camera
from tests.golden import GOLDEN
from tests.player.pages import PLAYER, open_player
from tests.player.test_headset import APART, HEADSET, SIDE, expect_eyes, eyes, wait_for_headset

pytestmark = pytest.mark.browser

EYES = 1.6
INPUTS = """
(() => {
  const {xr} = navigator, request = xr.requestSession;
  const pose = ([x, y, z], [a, b, c]) => ({transform: {matrix: new Float32Array([1,0,0,0, 0,1,0,0, -a,-b,-c,0, x,y,z,1])}});
  window.hand = (at, direction = [0, 0, -1]) => {
    const made = {at, direction, targetRayMode: 'tracked-pointer', targetRaySpace: {}, gamepad: {axes: [0, 0, 0, 0]}};
    made.targetRaySpace.hand = made;
    inputs.push(made);
    return made;
  };
  window.inputs = [];
  window.hits = [];
  window.send = (name, inputSource) => session.dispatchEvent(Object.assign(new Event(name), {inputSource}));
  xr.isSessionSupported = async () => true;
  xr.requestSession = async (mode, options) => {
    window.asked = [mode, options];
    const session = await request(), {requestAnimationFrame} = session;
    session.inputSources = inputs;
    session.requestReferenceSpace = async (type) => ({type});
    session.requestHitTestSource = async ({space}) => space;
    session.requestAnimationFrame = (draw) => requestAnimationFrame.call(session, (now, frame) => {
      const getPose = ({hand}) => pose(hand.at, hand.direction);
      const getHitTestResults = () => hits.map((at) => ({getPose: () => pose(at, [0, 0, -1])}));
      draw(now, {...frame, getPose, getHitTestResults});
      window.passed = (window.passed ?? 0) + 1;
    });
    return session;
  };
})();
"""


def enter(page: Page, server: Server, button: str) -> None:
    page.add_init_script(HEADSET)
    page.add_init_script(INPUTS)
    open_player(page, server)
    page.locator("splat-reel").get_by_role("button", name=button).click()
    page.wait_for_function("window.passed > 3")


def pass_frames(page: Page) -> None:
    """Let at least two frames read the inputs."""
    page.wait_for_function(f"window.passed > {page.evaluate('window.passed')} + 2")


def meters() -> float:
    """Return the meters per world unit, by which the median distance of the cameras is two meters."""
    reel = open_reel(GOLDEN)
    middle = np.asarray(reel.manifest.bounds).mean(0)
    return 2 / np.sort([np.linalg.norm(camera.center - middle) for camera in reel.manifest.cameras])[1]


def seen_from(
    position: tuple[float, float, float], yaw: float = 0.0, smaller: float = 1.0, background: bool = True
) -> list:
    """Return the CPU's images of the eyes at a position beside the reel's camera.

    Args:
        position: Meters to the right, up and back, as in WebXR.
        yaw: Radians to the left.
        smaller: Factor of the distance between the eyes.
        background: Whether the reel's background is behind.
    """
    reel = open_reel(GOLDEN)
    start = reel.manifest.camera
    right, up, back = position
    turn = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    K = np.array([[0.75 * SIDE, 0, SIDE / 2], [0, 0.75 * SIDE, SIDE / 2], [0, 0, 1]])
    images = []
    for side in (-1, 1):
        moved = np.eye(4)
        moved[:3, :3] = turn.T
        moved[:3, 3] = -turn.T @ (np.array([right, -up, -back]) / meters()) - [
            side * APART / 2 * smaller / meters(),
            0,
            0,
        ]
        camera = Camera("eye", moved @ start.viewmat, K, SIDE, SIDE)
        images.append(np.clip(reel.render(reel.at(0.0), camera), 0, 1))
    return images


def test_a_hand_takes_the_reel_along_and_does_not_play_it(page: Page, server: Server) -> None:
    enter(page, server, "Enter VR")
    wait_for_headset(page)
    page.evaluate("window.right = hand([0.2, 1.2, -0.4]); send('selectstart', right)")
    pass_frames(page)
    page.evaluate("right.at = [0.3, 1.2, -0.4]")  # the first move is within the dead zone or begins the grab
    pass_frames(page)
    page.evaluate("right.at = [0.55, 1.1, -0.5]")
    pass_frames(page)
    page.evaluate("send('select', right); send('selectend', right)")
    assert page.evaluate(f"{PLAYER}.paused") is True
    expect_eyes(page, *seen_from((-0.25, 0.1, 0.1)))
    page.evaluate("send('selectstart', right)")
    pass_frames(page)
    page.evaluate("send('select', right); send('selectend', right)")
    assert page.evaluate(f"{PLAYER}.paused") is False


def test_two_hands_make_the_reel_larger(page: Page, server: Server) -> None:
    enter(page, server, "Enter VR")
    wait_for_headset(page)
    page.evaluate(
        "window.pair = [hand([-0.2, 1.6, -2]), hand([0.2, 1.6, -2])]; pair.map((one) => send('squeezestart', one))"
    )
    pass_frames(page)
    page.evaluate("pair[0].at = [-0.25, 1.6, -2]; pair[1].at = [0.25, 1.6, -2]")
    pass_frames(page)
    page.evaluate("pair.map((one) => send('squeezeend', one))")
    # About a point two meters ahead, by a quarter: as if people came nearer to it, with eyes that are closer.
    expect_eyes(page, *seen_from((0, 0, -2 + 2 / 1.25), smaller=1 / 1.25))


def test_the_thumbstick_turns_and_teleports(page: Page, server: Server) -> None:
    enter(page, server, "Enter VR")
    wait_for_headset(page)
    page.evaluate("window.right = hand([0, 1, 0], [0, -0.8, -0.6]); right.gamepad.axes[2] = -1")
    pass_frames(page)
    page.evaluate("right.gamepad.axes[2] = 0")
    pass_frames(page)
    expect_eyes(page, *seen_from((0, 0, 0), yaw=np.pi / 6))
    page.evaluate("right.gamepad.axes[2] = 1")
    pass_frames(page)
    page.evaluate("right.direction = [0, -0.2425, -0.9701]; right.gamepad.axes = [0, 0, 0, -1]")
    pass_frames(page)
    assert max(eye.max() for eye in eyes(page)) == 1, "a ring on the floor"
    page.evaluate("right.direction = [0, -0.8, -0.6]")
    pass_frames(page)
    page.evaluate("right.gamepad.axes = [0, 0, 0, 0]")
    expect_eyes(page, *seen_from((0, 0, -0.75)))


def test_augmented_reality_puts_the_reel_on_the_floor_of_the_room(page: Page, server: Server) -> None:
    enter(page, server, "Enter AR")
    assert page.evaluate("asked") == [
        "immersive-ar",
        {"requiredFeatures": ["hit-test"], "optionalFeatures": ["local-floor"]},
    ]
    drawn = page.evaluate(f"{PLAYER}.stage.pictures")
    assert max(eye.max() for eye in eyes(page)) == 0, "there is no floor yet"
    page.evaluate("hits.push([0.4, 0, -2.5])")
    pass_frames(page)
    assert max(eye.max() for eye in eyes(page)) == 1, "a ring"
    assert page.evaluate(f"{PLAYER}.stage.pictures") == drawn, "and no reel"
    page.evaluate("send('select')")
    wait_for_headset(page)
    assert page.evaluate(f"{PLAYER}.paused") is True
    reel = open_reel(GOLDEN).manifest
    up = np.asarray(reel.up) / np.linalg.norm(reel.up)
    focus = np.asarray(reel.bounds).mean(0)
    low = min(np.dot([reel.bounds[i & 1][0], reel.bounds[i >> 1 & 1][1], reel.bounds[i >> 2][2]], up) for i in range(8))
    foot = reel.camera.viewmat[:3, :3] @ (focus + up * (low - focus @ up)) + reel.camera.viewmat[:3, 3]
    away = np.array([foot[0], -foot[1], -foot[2]]) * meters()  # in meters from the first view: right, up, back
    # The line from the foot to the first view now points to the viewer.
    yaw = np.arctan2(away[2], away[0]) - np.arctan2(-2.5, 0.4)
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    eye = away + turn.T @ (np.array([0, EYES, 0]) - [0.4, 0, -2.5])
    expect_eyes(page, *seen_from(tuple(eye), yaw=-yaw))
    pixels = np.frombuffer(base64.b64decode(page.evaluate("layer.pixels()")), np.uint8)
    assert pixels[3::4].min() == 0, "the room shows"
    page.locator("splat-reel").get_by_role("button", name="Leave AR").click()
    page.wait_for_function(f"!{PLAYER}.presented")
