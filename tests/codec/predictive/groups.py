"""Points and a group with motion, for the predictive codec."""

import numpy as np

from splatreel.config import EncodeConfig
from splatreel.scene.group import Group
from tests.golden import random_gaussians, random_motion

CONFIG = EncodeConfig(codec="predictive")


def points(count=300, degree=2, seed=0):
    return random_gaussians(np.random.default_rng(seed), count, degree, (0, 0, 0))


def group(count=300, frames=12):
    moving = points(count)
    dx, dq = random_motion(np.random.default_rng(1), moving, frames)
    return Group(0, 0, moving, dx, dq, np.zeros(0, bool))
