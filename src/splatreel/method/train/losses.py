"""Lists of the terms that trainings minimize: one list for each kind of keyframe, one for groups.

A term is a file of `terms/`. Its weight is a field of the configuration, and its schedule stands in these lists. Programs run any
list (`cpu_program.py`); GPUs run lists of terms that have kernels for them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.method.train.terms.opacity import Opacity
from splatreel.method.train.terms.photometric import Photometric
from splatreel.method.train.terms.rigidity import Rigidity
from splatreel.method.train.terms.smoothness import Smoothness
from splatreel.method.train.terms.surfaces import Roughness, Spread
from splatreel.method.train.terms.term import Moment, Term, due_terms, sum_of_weights
from splatreel.method.train.terms.view_dependence import ViewDependence

GROWTH = 0.6
"""Share of a keyframe's iterations in which points are added. Opacities cost something only after that, since it hinders
growth."""
SURFACES_FROM = 0.4
"""Share of a keyframe's iterations after which the terms of surfaces run. Earlier there are no surfaces yet."""

Terms = Sequence[Term[Any]]

PHOTOMETRIC = Photometric("photometric")
OPACITY = Opacity("opacity", "lambda_opacity", after=GROWTH)
KEYFRAME: Terms = (
    PHOTOMETRIC,
    OPACITY,
    Roughness("bent surfaces", "lambda_roughness", every=2, block=2, after=SURFACES_FROM),
    Spread("before surfaces", "lambda_spread", every=2, block=2, after=SURFACES_FROM),
)
CHAPTER_KEYFRAME: Terms = (PHOTOMETRIC, OPACITY)
"""Terms of new points in front of static ones. Those of surfaces do not apply: new content is seen from all around."""
KEYFRAME_BEFORE_STATIC: Terms = (PHOTOMETRIC,)
"""Terms of a later keyframe. Moving content has few points and needs all of them, so opacity costs nothing."""

GROUP: Terms = (
    PHOTOMETRIC,
    Rigidity("rigidity", "lambda_arap", every=2),
    Smoothness("smoothness", "lambda_temporal", every=8, first=1),
    ViewDependence("view dependence", "lambda_sh"),
)
"""Terms of a group. Changes of colors and opacities have a price in `Appearance.steps`, on the values of their spline."""


def weight_of(kind: type[Term[Any]], losses: Terms, step: Moment, config: KeyframeConfig | GroupConfig) -> float:
    """Return the sum of the weights in an iteration of all terms of a kind in a list; 0 if none runs."""
    return sum_of_weights(kind, due_terms(losses, step, config))


def psnr(image: np.ndarray, target: np.ndarray) -> float:
    """Return the PSNR, dB, of an image [H, W, 3] against its target, uint8."""
    error = np.square(np.clip(image, 0, 1) - target.astype(np.float32) / 255).mean()
    return -10 * math.log10(max(float(error), 1e-12))
