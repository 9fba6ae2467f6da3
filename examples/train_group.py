"""Train the motion of one group, one iteration at a time.

python examples/train_group.py --iterations 300

The scene is made up: a ball of Gaussians moves in front of a wall, and four cameras film five frames of it. Training starts from the
Gaussians of the first frame and learns how the ball moves, with the paper's hash grid. (The default model, splines, starts from tracks
of optical flow, which this example does not compute.) Replace the loop to log, to draw, or to stop where you like.
"""

from dataclasses import replace

import numpy as np
import tyro

import splatreel
from splatreel.training import group_trainer

FRAMES, WIDTH, HEIGHT = 5, 96, 64
NEAR, DISTANCE = 0.1, 4.0
"""Near plane, and distance of the cameras from the scene, in world units."""


def random_points(count: int, low: list[float], high: list[float], seed: int) -> splatreel.Gaussians:
    """Make round Gaussians of random colors in a box."""
    rng = np.random.default_rng(seed)
    return splatreel.Gaussians(
        means=rng.uniform(low, high, (count, 3)),
        quats=np.tile([1.0, 0, 0, 0], (count, 1)),
        scales=np.full((count, 3), 0.14),
        opacities=np.full(count, 0.95),
        sh=rng.uniform(-1.7, 1.7, (count, 1, 3)),
    )


def make_cameras() -> list[splatreel.Camera]:
    """Place four cameras side by side, looking along +z."""
    K = np.array([[WIDTH, 0, WIDTH / 2], [0, WIDTH, HEIGHT / 2], [0, 0, 1]])
    cameras = []
    for index, x in enumerate(np.linspace(-0.9, 0.9, 4)):
        viewmat = np.eye(4)
        viewmat[:3, 3] = [-x, 0, DISTANCE]
        cameras.append(splatreel.Camera(f"cam{index}", viewmat, K, WIDTH, HEIGHT))
    return cameras


def film(wall: splatreel.Gaussians, ball: splatreel.Gaussians, cameras: list[splatreel.Camera]) -> np.ndarray:
    """Draw the ball moving to the right in front of the wall: [T, C, H, W, 3] float32, 0..1."""
    images = []
    for frame in range(FRAMES):
        means = ball.means + np.array([0.06 * frame, 0, 0])
        moved = splatreel.Gaussians(means, ball.quats, ball.scales, ball.opacities, ball.sh)
        scene = splatreel.Gaussians.concatenate([wall, moved])
        images.append([splatreel.render(scene, camera, near=NEAR) for camera in cameras])
    return np.array(images)


def main(iterations: int = 300) -> None:
    """Train a group.

    Args:
        iterations: Iterations in total, at most 60 for each frame.
    """
    cameras = make_cameras()
    wall = random_points(400, [-3, -2, 0.9], [3, 2, 1.0], seed=0)
    ball = random_points(48, [-0.8, -0.6, -0.4], [0.2, 0.6, 0.2], seed=1)
    config = splatreel.preset("standard")
    group = replace(
        config.group, deformation="hashgrid", length=FRAMES, overlap=0, iterations_per_frame=60, coarse_share=0
    )
    config = replace(config, group=group)
    trainer = group_trainer(film(wall, ball, cameras), cameras, ball, wall, config, near=NEAR, device="cpu")

    losses = []
    for iteration in range(min(iterations, trainer.iterations)):
        losses.append(trainer.step(iteration))
        if len(losses) % 50 == 0:
            print(f"iteration {len(losses)}: loss {np.mean(losses[-50:]):.4f}")
    moved = trainer.result().dx[-1, :, 0].mean()
    print(f"The ball moved by {moved:.2f} of {0.06 * (FRAMES - 1):.2f} world units.")


if __name__ == "__main__":
    tyro.cli(main)
