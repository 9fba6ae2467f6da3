"""Recognition of the kind of a sequence."""

from __future__ import annotations

from pathlib import Path

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import MemoryBudget
from splatreel.formats.fourdgs import FourdgsScene
from splatreel.importing.dynamic3dgs import Dynamic3DGS
from splatreel.importing.frame_names import Gaps
from splatreel.importing.frames import Frames, ZipFrames, open_files
from splatreel.importing.spacetime import SpacetimeGaussians, is_spacetime
from splatreel.importing.training_folders import check_no_checkpoint

INPUT = "input.ply"
"""Copy of the first points that 3DGS's code leaves in the folder of a training."""
LOOKED_FOR = """\
  files of Gaussians:   frame0000.ply, frame0001.ply, ..., or .splat, .ksplat, .spz, .sog files;
                        or a numbered folder a frame with one file in it
  streamed SOG:         lod-meta.json
  one such file:        point_cloud.ply, scene.spz, ...
  zip archive:          of such files
  Dynamic 3D Gaussians: params.npz
  SpacetimeGaussians:   point_cloud.ply of a lite model, with its cfg_args
  4dgs:                 scene.4dgs"""


def open_frames(
    path: str | Path,
    gaps: Gaps = "refuse",
    fps: float | None = None,
    length: int | None = None,
    most: int | None = None,
) -> Frames:
    """Open a sequence of Gaussians: a folder, an archive or a single file.

    Args:
        path: Folder or file.
        gaps: Treatment of missing frame numbers.
        fps: Samples per second of a scene that is continuous in time; None takes its own.
        length: Number of frames of a model that does not state it.
        most: Memory in bytes that reading a file may take; None limits each file in proportion to its length.

    Raises:
        GaussiansError: The path is anything else, the order of the files is unclear, or frames are missing.
    """
    place = Path(path)
    found = _open(place, gaps, fps, length, MemoryBudget(most))
    if length is not None and not isinstance(found, SpacetimeGaussians):
        raise GaussiansError(f"{place}: has {len(found)} frames of its own. Leave out --length, or name a model.")
    return found


def _open(place: Path, gaps: Gaps, fps: float | None, length: int | None, budget: MemoryBudget) -> Frames:
    archive = place / "params.npz" if place.is_dir() else place
    if archive.suffix.lower() == ".npz" and archive.is_file():
        return Dynamic3DGS(archive, budget)
    if place.suffix.lower() == ".zip" and place.is_file():
        return ZipFrames(place, gaps, budget)
    if place.suffix.lower() == ".4dgs" and place.is_file():
        return FourdgsScene(place, fps, budget)
    if not place.exists():
        raise GaussiansError(f"{place}: does not exist. One of these was looked for:\n{LOOKED_FOR}")
    if (place.is_dir() or place.is_file()) and (found := open_files(place, gaps, budget)):
        one = found.files[0]
        if len(found) == 1 and one.name == INPUT:
            check_no_checkpoint(place)
        return SpacetimeGaussians(one, length, budget) if len(found) == 1 and is_spacetime(one, budget) else found
    if place.is_dir():
        check_no_checkpoint(place)
    raise GaussiansError(
        f"{place}: holds none of these:\n{LOOKED_FOR}"
        if place.is_dir()
        else f"{place}: is none of these:\n{LOOKED_FOR}"
    )
