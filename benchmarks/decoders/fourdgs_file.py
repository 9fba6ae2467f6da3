"""Read a .4dgs file with the package fourdgs: python fourdgs_file.py FILE FRAMES FPS. Prints as reel.mjs."""

import json
import re
import sys
import time
from pathlib import Path

import fourdgs  # pyright: ignore[reportMissingImports] - optional


def peak() -> int:
    """Return the largest memory of this process so far, bytes."""
    return 1024 * int(re.findall(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())[0])


path, frames, fps = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
began, memory = time.process_time(), peak()
scene = fourdgs.read(path)
decoded = time.process_time() - began
for frame in range(frames):
    scene.state_at((frame + 0.5) / fps)
values = {"decode_ms": 1000 * decoded, "all_ms": 1000 * (time.process_time() - began)}
print(json.dumps(values | {"memory_bytes": peak() - memory}))
