"""Show whether the thrown ball of Panoptic basketball survives in a reel, frame by frame.

python benchmarks/ball.py OUT CAPTURE --width 640

It is the one red thing in the scene: where a test camera sees it, the decoded reel must be red too.
"""

from pathlib import Path

import cv2
import numpy as np
import tyro

from record import record
from splatreel.capture.opening import open_capture
from splatreel.cli.options import parse_frames, reel_folder
from splatreel.play.timeline import open_reel

RED = 0.15
"""How much more red than green and blue, 0..1."""
SMALLEST = 2e-4
"""Share of the image below which what is seen of the ball is a sliver."""
THERE = 0.5
"""The share of its pixels above which the ball is there; here intersection over union of the red ones."""


def red(image: np.ndarray) -> np.ndarray:
    """Return the red pixels of an image as [H, W] bool, without specks.

    Args:
        image: [H, W, 3], 0..1.
    """
    mask = image[..., 0] - np.maximum(image[..., 1], image[..., 2]) > RED
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)) > 0


def main(
    reel: tyro.conf.Positional[Path],
    capture: tyro.conf.Positional[Path],
    /,
    width: int = 320,
    frames: str = "0:60",
    note: str = "",
) -> None:
    """Compare the red pixels of the decoded reel with those of every test camera, and record how well they overlap."""
    source = open_capture(capture, width=width, frames=parse_frames(frames))
    played = open_reel(reel_folder(reel))
    cameras = [camera for camera in source.cameras if camera.name in source.held_out]
    overlaps: dict[str, dict[int, float]] = {camera.name: {} for camera in cameras}
    for frame in range(source.frames):
        gaussians = played.at(frame / source.fps)
        truths = source.read(frame, 1, [camera.name for camera in cameras])[0]
        for camera, truth in zip(cameras, truths, strict=True):
            ball = red(truth / np.float32(255))
            if ball.mean() >= SMALLEST:
                shown = red(played.render(gaussians, camera))
                overlaps[camera.name][frame] = float((ball & shown).sum() / (ball | shown).sum())
    source.close()
    values = {"width": width, "frames": source.frames, "cameras": {n: found(seen) for n, seen in overlaps.items()}}
    record(f"basketball {width}, the ball", values, note)
    for name, summary in values["cameras"].items():
        print(f"camera {name}: {summary}")


def found(shares: dict[int, float]) -> dict:
    """Return the record of one camera.

    Args:
        shares: Share of the ball that the reel shows, 0..1, for each frame in which the camera sees it.
    """
    worst = min(shares, key=lambda frame: shares[frame])
    return {
        "seen": len(shares),
        "mean": round(float(np.mean(list(shares.values()))), 3),
        "worst": round(shares[worst], 3),
        "frame": worst,
        "lost": [frame for frame, share in shares.items() if share < THERE],
    }


if __name__ == "__main__":
    tyro.cli(main)
