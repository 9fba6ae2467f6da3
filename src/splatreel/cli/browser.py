"""Opening of pages in the user's browser."""

from __future__ import annotations

import os
import sys
import threading
import webbrowser


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
