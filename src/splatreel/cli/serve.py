"""`splatreel serve` and `splatreel view`."""

from __future__ import annotations

import importlib.util
import os
import sys
import threading
import webbrowser
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from splatreel.base.errors import UsageError
from splatreel.cli.options import OptionalReel, ReelAddress, megabytes, parse_names, reel_folder
from splatreel.cli.printing import print_qr_code, say

if TYPE_CHECKING:
    from splatreel.evaluation.page.report_page import ServedReport
    from splatreel.play.server import Server
    from splatreel.play.viewer import Viewer


def serve(
    reel: ReelAddress,
    /,
    host: str = "127.0.0.1",
    port: int = 8080,
    cors: bool = False,
    allow_host: str | None = None,
) -> None:
    """Serve a reel and its web player until Ctrl-C, and the report of its run as report.html.

    If other machines are let in, a QR code opens a page on a phone that tests the player there.

    Args:
        reel: Folder of the reel, or of the reconstruction that holds it, or a URL: http(s), s3://BUCKET/REEL and the like.
        host: Address to listen on; 0.0.0.0 lets other machines in.
        port: Port to listen on; 0 takes any free one.
        cors: Let pages of other sites read the reel.
        allow_host: Further host names that requests may name, such as a proxy's, as NAME,NAME.
    """
    from splatreel.play.server import Server

    allowed = parse_names(allow_host, "--allow-host") or ()
    folder = reel_folder(reel)
    pages = run_report(folder)
    server = Server(folder, host, port, cors, allowed, pages)
    run(server, browser=False, pages=pages, phones=server.network_url)


def show_self_test(url: str) -> None:
    """Print the address of the self-test page of a player, and its QR code."""
    page = f"{url}self-test.html"
    print_qr_code(page)
    say(f"Test a phone in this network: {page}")


def run_report(reel: str | Path, always: bool = False) -> dict[str, ServedReport]:
    """Return the report page of the run that a reel belongs to; empty for a reel without its run.

    Args:
        reel: Folder or address of the reel.
        always: The reel belongs to a run that has not begun yet.
    """
    from splatreel.storage.address import local_path

    folder = local_path(reel)
    if folder is None or importlib.util.find_spec("cv2") is None:
        return {}
    from splatreel.evaluation.page.report_page import ServedReport

    out = folder.resolve().parent
    of_a_run = folder.resolve().name == "reel" and (out / "work").is_dir()
    return {"report.html": ServedReport(out, folder)} if of_a_run or always else {}


def view(
    reel: OptionalReel = None,
    /,
    sample: bool = False,
    renderer: Literal["webgl", "cpu", "cuda"] = "webgl",
    port: int = 0,
    open: bool = True,
    width: int = 1280,
    max_memory: int | None = None,
) -> None:
    """Open a reel in the web browser, until Ctrl-C.

    Args:
        reel: Folder of the reel, or of the reconstruction that holds it, or a URL: http(s), s3://BUCKET/REEL and the like.
        sample: Open the sample reel of the package, the built-in scene, instead.
        renderer: webgl draws in the browser; cpu and cuda draw here and stream the images, without sound (needs splatreel[viewer]).
        port: Port to listen on; 0 takes any free one.
        open: Open the browser, or only print the address.
        width: Largest width in pixels that cpu and cuda draw.
        max_memory: Megabytes that cpu and cuda may take to decode a file; by default what a correct file of its length needs.
    """
    if sample == (reel is not None):
        raise UsageError("Name either a reel or --sample, such as `splatreel view out/demo`.")
    from splatreel.play.demo_page import sample_reel

    folder = sample_reel() if reel is None else reel_folder(reel)
    if renderer == "webgl":
        from splatreel.play.server import Server

        run(Server(folder, "127.0.0.1", port), browser=open)
    else:
        from splatreel.play.timeline import draw_on_cpu, open_reel
        from splatreel.play.viewer import Viewer
        from splatreel.run.device_choice import cuda_renderer

        draw = cuda_renderer() if renderer == "cuda" else draw_on_cpu
        run(Viewer(open_reel(folder, most=megabytes(max_memory)), draw, port=port, width=width), browser=open)


def run(player: Server | Viewer, browser: bool, pages: Iterable[str] = (), phones: str | None = None) -> None:
    """Serve until Ctrl-C, which is the normal end here.

    Args:
        player: The server.
        browser: Whether to open a browser.
        pages: Names of further pages.
        phones: URL of the player for phones; None if they are not let in.
    """
    with player:
        if phones:
            show_self_test(phones)
        wait_for_viewers(player, browser, pages)


def wait_for_viewers(player: Server | Viewer, browser: bool = False, pages: Iterable[str] = ()) -> None:
    """Print the addresses of a running server, and wait until Ctrl-C. Arguments are those of `run`."""
    for page in pages:
        say(f"Report at {player.url}{page}")
    say(f"Playing at {player.url} - stop with Ctrl-C", flush=True)
    if browser:
        open_browser(player.url)
    try:
        player.wait()
    except KeyboardInterrupt:
        say()


def has_browser() -> bool:
    """Return whether a page can be opened in a window. A browser in the terminal would take the terminal over."""
    if not os.environ.get("BROWSER") and sys.platform not in ("win32", "darwin", "cygwin"):
        screens = ("DISPLAY", "WAYLAND_DISPLAY", "WSL_DISTRO_NAME")
        if not any(os.environ.get(name) for name in screens):
            return False
    try:
        webbrowser.get()
    except webbrowser.Error:
        return False
    return True


def open_browser(url: str) -> bool:
    """Open a page in the browser, if there is one. Return whether there is. Nothing waits for the browser to start."""
    if not has_browser():
        return False
    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
    return True
