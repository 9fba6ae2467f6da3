"""`splatreel serve` and `splatreel view`."""

from __future__ import annotations

import webbrowser
from pathlib import Path

from tyro.conf import Positional

from splatreel.cli.options import reel_folder


def serve(reel: Positional[Path], /, host: str = "127.0.0.1", port: int = 8080) -> None:
    """Serve a reel and its web player until Ctrl-C.

    Args:
        reel: Folder of the reel, or of the reconstruction that holds it.
        host: Address to listen on; 0.0.0.0 lets other machines in.
        port: Port to listen on; 0 takes any that is free.
    """
    run(reel, host, port, browser=False)


def view(reel: Positional[Path], /, port: int = 0) -> None:
    """Open a reel in the web browser; ends with Ctrl-C.

    Args:
        reel: Folder of the reel, or of the reconstruction that holds it.
        port: Port to listen on; 0 takes any that is free.
    """
    run(reel, "127.0.0.1", port, browser=True)


def run(reel: Path, host: str, port: int, browser: bool) -> None:
    """Serve until Ctrl-C, which here is the normal end."""
    from splatreel.play.server import Server

    with Server(reel_folder(reel), host, port) as server:
        print(f"Playing at {server.url} - stop with Ctrl-C", flush=True)
        if browser:
            webbrowser.open(server.url)
        try:
            server.wait()
        except KeyboardInterrupt:
            print()
