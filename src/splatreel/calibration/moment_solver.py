"""Placement of the cameras of a capture at single moments: COLMAP models, by pycolmap."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from PIL import Image

from splatreel.base.progress import Progress
from splatreel.calibration.calibration_agreement import agreeing, rig_of
from splatreel.calibration.calibration_files import read_frame, write_image, write_photos
from splatreel.calibration.learned_matches import Matcher
from splatreel.capture.file_capture import FrameSource

MOMENTS = 3
"""Number of moments at which the cameras are placed, spread over the videos."""
ATTEMPTS = 16
"""Maximum number of attempts to place cameras of one lens at one moment: eight first pairs of images, with and without distortion. Of
few cameras, an attempt often places a part, or finds a wrong focal length. Which one does is chance: it changes with the last bits of
the processor's arithmetic."""
FEWEST = 15
"""Minimum number of learned matches of two images, as COLMAP demands of SIFT."""


class MomentSolver:
    """Solver that places the cameras at one moment after the other.

    Args:
        colmap: Module pycolmap.
        folder: New folder for temporary files.
        progress: Progress display.
        same_lens: True if all cameras have the same lens and zoom.
        photos: Photographs that connect the cameras' views.
        matcher: Learned matcher in place of SIFT, which does not match photographs.
    """

    def __init__(
        self,
        colmap: ModuleType,
        folder: Path,
        progress: Progress,
        same_lens: bool = False,
        photos: Sequence[Path] = (),
        matcher: Matcher | None = None,
    ) -> None:
        self.colmap = colmap
        self.folder = folder
        self.progress = progress
        self.matcher = matcher
        self.one_lens = same_lens
        self.lenses = colmap.CameraMode.SINGLE if same_lens else colmap.CameraMode.PER_IMAGE
        self.images = folder / "images"
        self.known = folder / "photos.db"
        self.databases: list[Path] = []
        self.images.mkdir(parents=True)
        self.photos = write_photos(list(photos), self.images, progress) if photos else []

    def solve(self, videos: FrameSource, names: list[str]) -> list[Any]:
        """Return the models of all moments that have one."""
        colmap, progress = self.colmap, self.progress
        if self.photos:
            progress.stage(f"comparing {len(self.photos)} photographs", 1)
            self._extract(self.known, self.photos, colmap.CameraMode.PER_FOLDER)
            self._match(self.known, 0)
            progress.update(1)
        frames = _moments(videos)
        progress.stage(f"placing {len(names)} cameras at {len(frames)} moments", 4 * len(frames))
        models = []
        for moment, frame in enumerate(frames):
            model = self._moment(videos, names, moment, frame)
            if model is not None:
                models.append(model)
        return models

    def _moment(self, videos: FrameSource, names: list[str], moment: int, frame: int) -> Any:
        """Return the model with the most cameras, or None."""
        database = self.folder / f"moment{moment}.db"
        self.databases.append(database)
        images = []
        for name in names:
            write_image(self.images / f"{name}.png", read_frame(videos, name, frame))
            images.append(f"{name}.png")
        self.progress.update(4 * moment + 1)
        if self.known.exists():
            shutil.copy(self.known, database)
        seed = moment + 1  # random choices should differ between moments
        if self.matcher is None:
            self._extract(database, images, self.lenses)
            self.progress.update(4 * moment + 2)
            self._match(database, seed)
        else:
            self._match_learned(self.matcher, database, images, seed)
        self.progress.update(4 * moment + 3)
        model = self._map_until_confirmed(database, seed, len(names))
        self.progress.update(4 * moment + 4)
        return model

    def _map_until_confirmed(self, database: Path, seed: int, cameras: int) -> Any:
        """Return the model of one moment with the most cameras and observations, or None.

        Cameras of one lens are placed several times, until two attempts agree on all of them.
        """
        models = list[Any]()
        for attempt in range(ATTEMPTS if self.one_lens else 1):
            found = self._map(database, seed + MOMENTS * (attempt // 2), distorts=attempt % 2 == 0)
            confirmed = [b for a in models for b in found if len(agreeing(rig_of(a), rig_of(b))) == cameras]
            models += found
            if confirmed:
                break
        return max(models, key=lambda model: (len(rig_of(model)), model.compute_num_observations()), default=None)

    def _map(self, database: Path, seed: int, distorts: bool) -> list[Any]:
        """Return the models of one attempt to place the cameras. `distorts`: the distortion of the lens is estimated, too."""
        options = self.colmap.IncrementalPipelineOptions()
        options.random_seed = seed
        options.num_threads = 1  # several threads sum in any order, which changes the result
        options.ba_refine_extra_params = distorts
        out = self.folder / f"{database.stem}-{seed}-{distorts}"
        out.mkdir()
        models = self.colmap.incremental_mapping(database, self.images, out, options=options)
        return [model for model in models.values() if rig_of(model)]

    def _extract(self, database: Path, images: list[str], mode: Any) -> None:
        """Extract the features of images. Images are numbered first, because threads finish in any order."""
        self.colmap.Database.open(database).close()
        self.colmap.import_images(database, self.images, camera_mode=mode, image_names=images)
        self.colmap.extract_features(database, self.images, image_names=images, camera_mode=mode)

    def _match(self, database: Path, seed: int) -> None:
        """Match features, reproducibly for the same seed. Without a seed each thread draws its own random numbers."""
        matching, verification = self.colmap.FeatureMatchingOptions(), self.colmap.TwoViewGeometryOptions()
        matching.guided_matching = True  # epipolar lines of roughly known cameras guide further matches
        verification.ransac.random_seed = seed
        self.colmap.match_exhaustive(database, matching_options=matching, verification_options=verification)

    def _match_learned(self, matcher: Matcher, database: Path, images: list[str], seed: int) -> None:
        """Find and match features with a network, and keep the matches that fit a geometry of two views."""
        colmap = self.colmap
        colmap.Database.open(database).close()
        colmap.import_images(database, self.images, camera_mode=self.lenses, image_names=images)
        pairs = list(combinations(images, 2))
        with colmap.Database.open(database) as file:
            numbers = {image.name: image.image_id for image in file.read_all_images()}
            found = {name: matcher.describe(np.array(Image.open(self.images / name))) for name in images}
            for name, features in found.items():
                file.write_keypoints(numbers[name], features.points)
            for one, other in pairs:
                rows = matcher.match(found[one], found[other])
                if len(rows) >= FEWEST:
                    file.write_matches(numbers[one], numbers[other], rows.astype(np.uint32))
        listed = database.with_suffix(".txt")
        listed.write_text("".join(f"{one} {other}\n" for one, other in pairs), encoding="utf-8")
        verification = colmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = seed
        colmap.verify_matches(database, listed, options=verification)


def _moments(videos: FrameSource) -> list[int]:
    return np.unique(np.linspace(0, videos.frames - 1, MOMENTS).round().astype(int)).tolist()
