"""Measure a live reconstruction: cameras write in real time, and a browser plays the live reel.

python benchmarks/follow.py --seconds 180

Needs Chromium and the playwright package. It says how long after it was filmed each group is shown, and for how long the image in
the browser stood still.
"""

import itertools
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import av
import numpy as np
import tyro
from playwright.sync_api import sync_playwright

from record import record
from splatreel.capture.base import Capture
from splatreel.capture.growth import END
from splatreel.capture.opening import open_capture
from splatreel.play.server import serve
from toyroom.capture import make_capture

PLAYER = "document.querySelector('splat-reel')?.player"
LOOK = 0.1
"""Seconds between two looks at the browser."""
SHOWN = re.compile(r"Group (\d+) written ([\d.]+) s after its last frame was filmed")


class Show:
    """Videos in MPEG-TS that are written frame by frame, playing a capture forward and backward."""

    def __init__(self, folder: Path, capture: Capture, poses: Path, fps: int, cameras: int) -> None:
        self.folder = folder
        self.fps = fps
        folder.mkdir(parents=True)
        chosen = np.linspace(0, len(capture.cameras) - 1, cameras).round().astype(int)
        np.save(folder / poses.name, np.load(poses)[chosen])
        names = [capture.cameras[number].name for number in chosen]
        self._images = capture.read(0, capture.frames, names)
        self._files = [av.open(str(folder / f"{name}.ts"), "w", options={"flush_packets": "1"}) for name in names]
        self._streams = [file.add_stream("libx264", rate=fps) for file in self._files]
        for stream in self._streams:
            stream.width, stream.height, stream.pix_fmt = capture.width, capture.height, "yuv420p"
            stream.codec_context.options = {"crf": "12", "g": str(fps), "preset": "ultrafast", "tune": "zerolatency"}
            stream.codec_context.thread_count = 1
        self.late = 0.0

    def film(self, seconds: float) -> None:
        """Write frames in real time.

        Args:
            late: Receives the largest delay of a frame, in seconds.
        """
        begun, count = time.monotonic(), len(self._images)
        there_and_back = [*range(count), *range(count - 2, 0, -1)]
        for number, source in enumerate(itertools.islice(itertools.cycle(there_and_back), round(seconds * self.fps))):
            wait = begun + number / self.fps - time.monotonic()
            time.sleep(max(wait, 0))
            self.late = max(self.late, -wait)
            for file, stream, image in zip(self._files, self._streams, self._images[source], strict=True):
                file.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")))
        for file, stream in zip(self._files, self._streams, strict=True):
            file.mux(stream.encode(None))
            file.close()
        (self.folder / END).touch()


def wait_for(reel: Path, over: threading.Event) -> None:
    """Wait for the first group.

    Args:
        over: Set when nothing more comes.
    """
    while not (reel / "manifest.json").exists():
        if over.wait(0.2):
            raise SystemExit("The reconstruction ended before its first group; see its log.")


def watch(url: str) -> dict:
    """Play a live reel to its end, and return how long the image stood still."""
    with sync_playwright() as driver:
        path = next(
            found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))
        )
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 480, "height": 360})
        page.goto(f"{url}?loop=0&muted=1")
        times: list[tuple[float, float]] = []
        while True:
            state = page.evaluate(f"(p => p && p.canPlay ? [p.currentTime, p.ended] : null)({PLAYER})")
            if state is not None:
                times.append((time.monotonic(), state[0]))
                if state[1]:
                    break
            time.sleep(LOOK)
        browser.close()
    moved = [times[0][0]] + [now for (_, a), (now, b) in itertools.pairwise(times) if b > a + 1e-3]
    stalls = [later - before for before, later in itertools.pairwise(moved)]
    return {
        "watched_s": round(moved[-1] - moved[0], 1),
        "longest_stall_s": round(max(stalls), 2),
        "stalls_over_half_s": sum(stall > 0.5 for stall in stalls),
    }


def main(
    seconds: float = 180,
    width: int = 64,
    height: int = 48,
    cameras: int = 6,
    fps: int = 5,
    group: int = 15,
    iterations: int = 3,
    when_late: str = "draft",
    keep: float = 60,
    out: Path = Path("out/benchmark-follow"),
    note: str = "",
) -> None:
    """Film, follow, watch, record.

    Args:
        group: Frames of a group.
        iterations: Motion iterations per frame.
    """
    shutil.rmtree(out, ignore_errors=True)
    film = make_capture(out / "film", width=width, height=height, frames=30, fps=fps, seed=0)
    with closing(open_capture(film)) as capture:
        show = Show(out / "show", capture, film / "poses_bounds.npy", fps, cameras)
    settings = [f"group.length={group}", f"group.iterations_per_frame={iterations}", "group.overlap=2"]
    settings += ["keyframe.first_iterations=150", "keyframe.refine_iterations=20", "check_coverage=false"]
    settings += ["group.tracks=false"]  # they take two thirds of a group of this size
    command = [
        sys.executable,
        "-m",
        "splatreel",
        "reconstruct",
        str(show.folder),
        "--out",
        str(out / "run"),
        "--follow",
    ]
    command += ["--keep", str(keep), "--when-late", when_late, "--quality", "draft", "--hold-out", "none"]
    command += [part for setting in settings for part in ("--set", setting)]
    over = threading.Event()
    with (out / "log.txt").open("w") as log:
        camera = threading.Thread(target=show.film, args=(seconds,))
        camera.start()
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        threading.Thread(target=lambda: (process.wait(), over.set()), daemon=True).start()
        try:
            wait_for(out / "run" / "reel", over)
            with serve(out / "run" / "reel", port=0) as server:
                seen = watch(server.url)
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            camera.join()
    text = (out / "log.txt").read_text()
    delays = [float(found[2]) for found in SHOWN.finditer(text)]
    values = {
        "cameras": cameras,
        "size": f"{width}x{height}",
        "fps": fps,
        "group_s": group / fps,
        "filmed_s": seconds,
        "written_late_s": round(show.late, 2),
        "groups_shown": text.count(" shown"),
        "first_delay_s": delays[0] if delays else None,
        "median_delay_s": round(float(np.median(delays)), 1) if delays else None,
        "last_delay_s": delays[-1] if delays else None,
        "cannot_keep_up": text.count("Too slow"),
        **seen,
    }
    print(record("follow", values, note))


if __name__ == "__main__":
    tyro.cli(main)
