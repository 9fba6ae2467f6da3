"""Segmentation of the subject in the images of several static cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.method.images.people import People, people_free, squares_around, without_repeats
from splatreel.method.init.layout import up_angles
from splatreel.scene.camera import Camera
from splatreel.segmentation.background import MIN_SAMPLES, Background, fit_background, largest_channel, same_light
from splatreel.segmentation.borders import with_border_opacity
from splatreel.segmentation.evidence import LIMIT, Agreement, ColorModel, difference, subject_evidence, with_floor
from splatreel.segmentation.smoothing import decide, with_doubts, without_halo, without_specks

DIFFERENT = 15.0
"""Smallest difference of the second color of a pixel from the first, gray levels."""
MARGIN = 1.0
"""Log odds by which the first color must be more likely the subject's than the second color is."""
AREA = 5
"""Side of the square over which these log odds are averaged, pixels."""
REACH = 11
"""Side of the square, pixels, in which colors on both sides of a border are compared."""


def uncover(background: Background, samples: np.ndarray, colors: ColorModel) -> tuple[Background, np.ndarray]:
    """Find the background where the subject covers it in most samples.

    The most frequent color of a pixel may be that of somebody who stands there for most of the video. Their moving parts have taught
    the colors of the subject. If the first color is the subject's, and the second one is not, the second is the background, provided
    that it continues the background around it better than the first color does.

    Args:
        background: Background by the most frequent colors.
        samples: [S, H, W, 3] uint8.
        colors: Colors of the subject and of its surroundings.

    Returns:
        The background, and the pixels [H, W] bool that changed.
    """
    away = largest_channel(np.abs(samples.astype(np.float32) - background.image)) > DIFFERENT
    second = fit_background(samples, away.astype(np.float32))
    often = second.share > (MIN_SAMPLES - 0.5) / len(samples)
    differs = largest_channel(np.abs(second.image - background.image)) > DIFFERENT
    first_odds, second_odds = (_mean_odds(colors, image) for image in (background.image, second.image))
    taken = often & differs & (first_odds > 0) & (first_odds - second_odds > MARGIN)
    taken = cv2.morphologyEx(taken.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    taken = _continuing(taken, background.image, second.image)
    found = replace(
        background,
        image=np.where(taken[..., None], second.image, background.image),
        noise=np.where(taken, second.noise, background.noise),
        share=np.where(taken, second.share, background.share),
        known=background.known | taken,
    )
    return found, taken


def _continuing(taken: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the parts of `taken` [H, W] bool in which a second image continues what is around better than the first does.

    Args:
        taken: [H, W] bool.
        first: [H, W, 3] float32, the image around, and within.
        second: [H, W, 3] float32, the other image within.
    """
    count, parts = cv2.connectedComponents(taken.astype(np.uint8))
    inside, square = taken.astype(np.float32), np.ones((REACH, REACH), np.uint8)
    weight = cv2.blur(inside, (REACH, REACH))
    mixed = cv2.dilate(inside, np.ones((3, 3), np.uint8)) > 0  # borders mix colors
    around = ~mixed & (cv2.dilate(inside, square) > 0)
    part = cv2.dilate(parts.astype(np.float32), square)[around].astype(np.int64)
    errors = []
    for image in (first, second):
        mean = cv2.blur(image * inside[..., None], (REACH, REACH))[around] / weight[around][:, None]
        errors.append(np.bincount(part, np.abs(mean - first[around]).max(-1), count))
    better = errors[1] < errors[0]
    return taken & better[np.asarray(parts)]


def _mean_odds(colors: ColorModel, image: np.ndarray) -> np.ndarray:
    """Return the log odds [H, W] of the subject by the colors of an image [H, W, 3] float32, averaged over small squares."""
    return cv2.blur(colors.evidence(np.clip(image, 0, 255).astype(np.uint8)), (AREA, AREA))


FULL_TRUST = 8
"""Number of other cameras at which their agreement weighs as much as the image itself."""
COLOR_SAMPLES = 10
"""Number of samples from which colors are learned."""
CERTAIN = 0.9
"""Decision above which a pixel teaches the colors of the subject or its surroundings."""
ALWAYS, STILL = 2.8, 0.9
"""Mean support by the other cameras, and share of the samples that look alike, above which a pixel's background is somebody who
never moves."""
NEAR = 0.08
"""Distance from the subject within which its surroundings teach colors, as a share of the image width."""
FIT_STEPS = 5
"""Number of steps of `fit_subject`."""
PERSON_SLOPE, PERSON_OFFSET, OWN_SHARE, OWN_LIMIT = 2.0, 0.5, 0.5, 4.0
"""Weight and offset of the log odds of the networks of people, and weight and limit of all other evidence beside them."""
SOFT = 0.02
"""Added to probabilities, so that their log odds are finite."""
NOBODY = 0.3
"""Largest probability of a person within something that moves and is not a person, such as a ball."""
STEADY = 12.0
"""Difference of colors, gray levels, up to which a pixel of the next frame shows the same."""


class Evidence(NamedTuple):
    """Log odds of the subject at a moment, each [C, H, W] float32: by the image alone, by the other cameras, and by both."""

    own: np.ndarray
    support: np.ndarray
    odds: np.ndarray


class SubjectModel:
    """Backgrounds and colors of a capture, by which its subject is segmented.

    Attributes:
        never_uncovered: Share of each camera's image, 0..1, whose background no sample shows although the other cameras show
            somebody there.
        moving_shares: Largest share of each camera's image, 0..1, that the subject covers in the samples.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        backgrounds: Sequence[Background],
        near: float = 0.0,
        people: People | None = None,
    ) -> None:
        self.cameras = list(cameras)
        self.people = people
        self._angles = up_angles(self.cameras)
        self.backgrounds = list(backgrounds)
        self.colors = [ColorModel() for _ in cameras]
        self.agreement = Agreement(self.cameras, near)
        self.never_uncovered = [0.0] * len(self.cameras)
        self.moving_shares = [0.0] * len(self.cameras)

    def pack(self) -> dict[str, np.ndarray]:
        """Return the model as arrays."""
        arrays: dict[str, np.ndarray] = {"never_uncovered": np.array(self.never_uncovered)}
        arrays["moving_shares"] = np.array(self.moving_shares)
        for c, (background, colors) in enumerate(zip(self.backgrounds, self.colors, strict=True)):
            arrays |= {f"{c}.{name}": getattr(background, name) for name in Background.__dataclass_fields__}
            arrays[f"{c}.colors"] = colors.counts
        return arrays

    @classmethod
    def unpack(
        cls, cameras: Sequence[Camera], arrays: dict[str, np.ndarray], near: float, people: People | None = None
    ) -> SubjectModel:
        """Return the model of arrays that `pack` returned.

        Raises:
            KeyError: An array is missing.
        """
        fields = Background.__dataclass_fields__
        packed = [{name: arrays[f"{c}.{name}"] for name in fields} for c in range(len(cameras))]
        backgrounds = [Background(floor=float(each.pop("floor")), **each) for each in packed]
        model = cls(cameras, backgrounds, near, people)
        model.never_uncovered = arrays["never_uncovered"].tolist()
        model.moving_shares = arrays["moving_shares"].tolist()
        model.colors = [ColorModel(arrays[f"{c}.colors"]) for c in range(len(cameras))]
        return model

    def evidence(self, images: np.ndarray, there: np.ndarray | None = None) -> Evidence:
        """Return the evidence of a moment.

        Args:
            images: [C, H, W, 3] uint8.
            there: [C] bool, cameras that have an image of this moment; None means all. Other images say nothing.
        """
        pairs = zip(images, self.backgrounds, strict=True)
        own = np.stack(threads.map_parallel(lambda pair: subject_evidence(*pair), pairs))
        if there is not None:
            own[~there] = 0
        return self._agreed(own, self.agreement.support(own))

    def _agreed(self, own: np.ndarray, support: np.ndarray) -> Evidence:
        trust = min(1.0, max(len(self.cameras) - 2, 1) / FULL_TRUST)
        shares = np.stack([background.share for background in self.backgrounds])
        # A background that few samples show may be somebody who stood there. Then the other cameras decide.
        odds = np.where((own < 0) & (support > 0), own * np.clip(1.5 * shares, 0, 1), own)
        odds = odds + np.clip(trust * support, -LIMIT, LIMIT)
        return Evidence(own, support, odds.astype(np.float32))

    def learn_colors(self, samples: np.ndarray, there: np.ndarray) -> None:
        """Learn the colors of the subject and of its surroundings anew from samples [S, C, H, W, 3] uint8 that are there [S, C]."""
        self.colors = [ColorModel() for _ in self.cameras]
        self.moving_shares = [0.0] * len(self.cameras)
        for images, exist in zip(samples, there, strict=True):
            found = self.evidence(images, exist)

            def learn(c: int, images: np.ndarray = images, found: Evidence = found) -> None:
                decision = decide(images[c], found.odds[c])
                self.moving_shares[c] = max(self.moving_shares[c], float((decision > 0).mean()))
                near = _widened((decision > 0) | (found.support[c] > 0))
                empty = (found.support[c] < 0) | (found.own[c] < -2)
                self.colors[c].add(
                    images[c], (decision > CERTAIN) & (found.odds[c] > 1), near & empty & (decision < -CERTAIN)
                )

            threads.map_parallel(learn, np.flatnonzero(exist).tolist())

    def decisions(self, images: np.ndarray, there: np.ndarray | None = None) -> tuple[np.ndarray, Evidence]:
        """Return decisions, from -1 to 1, [C, H, W] float32, and their evidence, of a moment. Arguments: as `evidence`."""
        found = self.evidence(images, there)
        colors = np.stack(threads.map_parallel(lambda c: self.colors[c].evidence(images[c]), range(len(images))))
        decided = _decided(images, found.odds + np.where(found.support > -0.5, colors, 0))
        if self.people is None:
            return decided, found
        return self._with_people(images, there, found, colors, decided)

    def _with_people(
        self, images: np.ndarray, there: np.ndarray | None, found: Evidence, colors: np.ndarray, decided: np.ndarray
    ) -> tuple[np.ndarray, Evidence]:
        """Return decisions and evidence that networks of people complete. What moves and is not a person stays.

        The cameras agree again, with what the networks see.
        """
        people = self.people
        assert people is not None

        def look(c: int) -> tuple[np.ndarray, np.ndarray]:
            known = squares_around(decided[c] > 0)
            return people.probability(images[c], without_repeats(known, people.find(images[c], self._angles[c])))

        seen = threads.map_parallel(look, range(len(images)))
        probability = np.stack([each for each, _ in seen])
        where = np.stack([known & ~_nobody(own > 0, each) for own, (each, known) in zip(decided, seen, strict=True)])
        if there is not None:
            where[~there] = False
        person = np.log((probability + SOFT) / (1 - probability + SOFT)) + PERSON_OFFSET
        near = np.where(found.support > -0.5, colors, 0)

        def joined(odds: np.ndarray, slope: float) -> np.ndarray:
            return slope * person + OWN_SHARE * np.clip(odds + near, -OWN_LIMIT, OWN_LIMIT)

        own = np.where(where, np.clip(joined(found.own, 1), -LIMIT, LIMIT), found.own).astype(np.float32)
        support = self.agreement.support(own)
        agreed = self._agreed(found.own, support).odds
        odds = np.where(where, joined(agreed, PERSON_SLOPE), agreed + np.where(support > -0.5, colors, 0))
        return _decided(images, odds.astype(np.float32)), Evidence(own, support, agreed)

    def masks(self, frames: np.ndarray, there: np.ndarray | None = None) -> np.ndarray:
        """Return the masks [T, C, H, W] uint8 of consecutive frames [T, C, H, W, 3] uint8.

        White is the subject and black its surroundings. LIKELY_GRAY and UNLIKELY_GRAY are in doubt. Other gray levels tell the opacity
        of border pixels. Cameras that are not `there` [T, C] bool say nothing, and their masks mean nothing.
        """
        there = np.ones(frames.shape[:2], bool) if there is None else there
        found = [self.decisions(*pair) for pair in zip(frames, there, strict=True)]
        out = np.empty(frames.shape[:4], np.uint8)
        for t in range(len(frames)):
            total = 2 * found[t][0]
            for other in (t - 1, t + 1):
                if 0 <= other < len(frames):
                    alike = _alike(frames[t], frames[other]) & there[other, :, None, None]
                    total += np.where(alike, found[other][0], found[t][0])
            evidence = found[t][1]
            for c, (decision, own, support) in enumerate(zip(total, evidence.own, evidence.support, strict=True)):
                mask = without_halo(decision > 0, difference(frames[t, c], self.backgrounds[c]))
                out[t, c] = with_doubts(without_specks(mask, support), own, support)
        return self.with_border_opacity(out, frames)

    def with_border_opacity(self, masks: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Return masks [T, C, H, W] uint8 of frames [T, C, H, W, 3] uint8 with the opacities of their borders (`borders`)."""
        jobs = [job for pair in zip(masks, frames, strict=True) for job in zip(*pair, self.backgrounds, strict=True)]
        return np.stack(threads.map_parallel(lambda job: with_border_opacity(*job), jobs)).reshape(masks.shape)


def fit_subject(
    cameras: Sequence[Camera],
    samples: np.ndarray,
    plates: Sequence[np.ndarray | None] | None = None,
    near: float = 0.0,
    report: Callable[[int], None] = lambda _: None,
    there: np.ndarray | None = None,
    people: People | None = None,
) -> SubjectModel:
    """Learn the backgrounds and colors of a capture.

    First backgrounds are found in each camera alone. By these, the cameras agree on the places of the subject in all samples. Then
    backgrounds are found again from the samples that do not show the subject. Colors tell where it still covers them.

    Args:
        cameras: C cameras, at the size of the images.
        samples: [S, C, H, W, 3] uint8, moments spread over the video.
        plates: Images without the subject, [P, H, W, 3] uint8 for each camera that has some.
        near: Smallest depth, world units.
        report: Called with the number of finished steps of `FIT_STEPS`.
        there: [S, C] bool, the samples that exist; None means all.
        people: Networks that find people. What they cover is kept out of the backgrounds.
    """
    there = np.ones(samples.shape[:2], bool) if there is None else there
    films = [film[exist] for film, exist in zip(samples.swapaxes(0, 1), there.T, strict=True)]
    plates = [None] * len(films) if plates is None else plates
    lit = threads.map_parallel(
        same_light, [film if plate is None else plate for film, plate in zip(films, plates, strict=True)]
    )
    shares = [0.0] * len(films)
    if people is not None:
        empty = [people_free(people, film, angle) for film, angle in zip(films, up_angles(cameras), strict=True)]
        shares = [float((~each).mean((1, 2)).max()) for each in empty]
        lit = [
            (film, free if certainty is None else free * certainty) if plate is None else (film, certainty)
            for (film, certainty), free, plate in zip(lit, empty, plates, strict=True)
        ]
    backgrounds = threads.map_parallel(
        lambda job: with_floor(fit_background(*job[0]), job[1]), zip(lit, films, strict=True)
    )
    model = SubjectModel(cameras, backgrounds, near, people)
    report(1)
    chosen = np.unique(np.linspace(0, len(samples) - 1, COLOR_SAMPLES).round().astype(int))
    own = [c for c, plate in enumerate(plates) if plate is None]
    if own:
        support = np.stack(
            [model.evidence(*pair).support for pair in zip(samples, there, strict=True)], 1
        )  # [C, S, H, W]
        report(2)
        found = threads.map_parallel(lambda c: _fit_again(films[c], *lit[c], support[c][there[:, c]]), own)
        for c, (background, covered) in zip(own, found, strict=True):
            model.backgrounds[c] = background.without(covered)
        report(3)
        model.learn_colors(samples[chosen], there[chosen])
        colors = ColorModel.merged(model.colors)
        uncovered = threads.map_parallel(lambda c: uncover(model.backgrounds[c], lit[c][0], colors), own)
        for c, (_, covered), (background, taken) in zip(own, found, uncovered, strict=True):
            model.backgrounds[c] = background
            model.never_uncovered[c] = float((covered & ~taken).mean())
    report(4)
    model.learn_colors(samples[chosen], there[chosen])
    model.moving_shares = [max(pair) for pair in zip(model.moving_shares, shares, strict=True)]
    report(FIT_STEPS)
    return model


def _fit_again(
    film: np.ndarray, lit: np.ndarray, certainty: np.ndarray | None, support: np.ndarray
) -> tuple[Background, np.ndarray]:
    """Return a background by the support of the other cameras, and the pixels [H, W] bool that the subject always covers.

    Args:
        film: [S, H, W, 3] uint8.
        lit: The same in one light.
        certainty: [S, H, W] how certain its pixels are; None means that all are.
        support: [S, H, W] float32.
    """
    uncovered = np.exp(-np.clip(support, 0, LIMIT)).astype(np.float32)
    background = with_floor(fit_background(lit, uncovered if certainty is None else uncovered * certainty), film)
    always = np.clip(support, -LIMIT, LIMIT).mean(0) > ALWAYS
    return background, always & (background.share > STILL)


def _decided(images: np.ndarray, odds: np.ndarray) -> np.ndarray:
    return np.stack(threads.map_parallel(lambda c: decide(images[c], odds[c]), range(len(images))))


def _nobody(mask: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Return the parts of a mask [H, W] bool, and what is close to them, that show no person."""
    count, found = cv2.connectedComponents(mask.astype(np.uint8))
    parts = np.asarray(found, np.int64)
    likely = np.zeros(count, np.float32)
    np.maximum.at(likely, parts.ravel(), probability.ravel())
    likely[0] = 1
    return cv2.dilate((likely < NOBODY)[parts].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


def _widened(mask: np.ndarray) -> np.ndarray:
    size = 2 * max(1, round(NEAR * mask.shape[1] / 2)) + 1
    return cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0


def _alike(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return where two images show the same. Arrays: [C, H, W, 3] uint8; the result is [C, H, W] bool."""
    return np.stack([largest_channel(cv2.absdiff(x, y)) < STEADY for x, y in zip(a, b, strict=True)])
