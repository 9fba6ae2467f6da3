"""`splatreel serve` and `splatreel view`."""

from __future__ import annotations

import webbrowser
from typing import TYPE_CHECKING, Literal

from splatreel.cli.options import ReelAddress, megabytes, parse_names, reel_folder
from splatreel.cli.output import say

if TYPE_CHECKING:
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
    """Serve a reel and its web player until Ctrl-C.

    Args:
        reel: Folder of the reel, or of the reconstruction that holds it, or a URL: http(s), s3://BUCKET/REEL and the like.
        host: Address to listen on; 0.0.0.0 lets other machines in.
        port: Port to listen on; 0 takes any that is free.
        cors: Let pages of other sites read the reel.
        allow_host: Further names that it may be reached by, such as a proxy's, with commas between them.
    """
    from splatreel.play.server import Server

    allowed = parse_names(allow_host, "--allow-host") or ()
    run(Server(reel_folder(reel), host, port, cors, allowed), browser=False)


def view(
    reel: ReelAddress,
    /,
    renderer: Literal["webgl", "cpu", "cuda"] = "webgl",
    port: int = 0,
    open: bool = True,
    width: int = 1280,
    max_memory: int | None = None,
) -> None:
    """Open a reel in the web browser; ends with Ctrl-C.

    Args:
        reel: Folder of the reel, or of the reconstruction that holds it, or a URL: http(s), s3://BUCKET/REEL and the like.
        renderer: webgl draws in the browser; cpu and cuda draw here and stream the pictures, without sound (needs splatreel[viewer]).
        port: Port to listen on; 0 takes any that is free.
        open: Open the browser, or only print the address.
        width: Most pixels across that cpu and cuda draw.
        max_memory: Megabytes that cpu and cuda may take to decode a file; by default what one of its length honestly needs.
    """
    folder = reel_folder(reel)
    if renderer == "webgl":
        from splatreel.play.server import Server

        run(Server(folder, "127.0.0.1", port), browser=open)
    else:
        from splatreel.play.renderers import renderer as choose
        from splatreel.play.timeline import open_reel
        from splatreel.play.viewer import Viewer

        run(
            Viewer(open_reel(folder, most=megabytes(max_memory)), choose(renderer), port=port, width=width),
            browser=open,
        )


def run(player: Server | Viewer, browser: bool) -> None:
    """Serve until Ctrl-C, which here is the normal end."""
    with player:
        say(f"Playing at {player.url} - stop with Ctrl-C", flush=True)
        if browser:
            webbrowser.open(player.url)
        try:
            player.wait()
        except KeyboardInterrupt:
            say()
