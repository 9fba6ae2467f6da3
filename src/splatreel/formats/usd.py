"""Gaussians of a reel as an animated USD file: a prim of the schema ParticleField3DGaussianSplat with a time sample per frame.

Source:
    https://openusd.org/release/user_guides/schemas/usdVol/ParticleField3DGaussianSplat.html
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.atomic import move, scratch
from splatreel.base.command_line import install_command
from splatreel.base.errors import GaussiansError
from splatreel.formats.registry import Film
from splatreel.scene.gaussians import Gaussians, turned

_NAMES = {
    "means": "Positions",
    "quats": "Orientations",
    "scales": "Scales",
    "opacities": "Opacities",
    "sh": "RadianceSphericalHarmonicsCoefficients",
}
"""Attribute of each field of Gaussians."""
_PAIRS, _TEXT = 6, 3
"""Pairs of frames that an estimate looks at, and bytes of text per byte of a number."""
_SHOWN = 3.0
"""Standard deviations of a point that its extent covers."""


def write_usd(path: Path, film: Film, fps: float) -> None:
    """Write the Gaussians at all times as one USD file, atomically. Its y axis is up, its unit the meter, its colors sRGB.

    A value is written where it differs from the frame before. It is then also written at that frame, since programs
    interpolate between samples of equal length. The first frame is the default value, which programs without time show.

    Args:
        path: Output file: .usdz, .usdc or .usda.
        film: The Gaussians.
        fps: Frames per second of the file.

    Raises:
        GaussiansError: The package usd-core is missing, or the file cannot be written.
    """
    try:
        from pxr import Gf, Sdf, Usd, UsdGeom, UsdUtils, UsdVol  # pyright: ignore[reportMissingImports] - optional

        schema = UsdVol.ParticleField3DGaussianSplat
    except (ImportError, AttributeError) as error:
        raise GaussiansError(
            f"{path}: needs usd-core, 26.3 or newer, to be written. Run\n  {install_command('usd')}"
        ) from error
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.LinearUnits.meters)
    stage.SetTimeCodesPerSecond(fps)
    stage.SetFramesPerSecond(fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(film.seconds) - 1)
    place = film.placement
    splats = schema.Define(stage, "/Splats")
    stage.SetDefaultPrim(splats.GetPrim())
    color_space = Gf.ColorSpaceNames.SRGBRec709  # the colors are those of the images that the points were trained on
    Usd.ColorSpaceAPI.Apply(splats.GetPrim()).CreateColorSpaceNameAttr(color_space)
    _attribute(splats, _NAMES["sh"]).SetColorSpace(color_space)
    if place.shift is not None:
        UsdGeom.Xformable(splats).AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(tuple(place.shift.tolist()))
    before: Gaussians | None = None
    for frame, points in enumerate(film):
        points = turned(points, place.turn)
        _set_frame(splats, frame, before, points)
        before = points
    try:
        with scratch(path.parent, path.name) as folder:
            plain = folder / (path.name if path.suffix != ".usdz" else f"{path.stem}.usdc")
            stage.GetRootLayer().Export(str(plain))
            if path.suffix == ".usdz":
                packed = folder / path.name
                if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(plain)), str(packed)):
                    raise GaussiansError(f"{path}: could not be packed. Write a .usdc file.")
                plain = packed
            move(plain, path)
    except OSError as error:
        raise GaussiansError(
            f"{path}: could not be written ({error.strerror}). Free space or choose a path."
        ) from error


def estimate_bytes(path: Path, film: Film) -> int:
    """Return about how many bytes `write_usd` will write, from some pairs of neighboring frames.

    `path`: Output file, whose suffix counts: numbers take three times as many bytes in text.
    """
    steps = len(film.seconds) - 1
    total = _changed_bytes(None, film.at(film.seconds[0]))
    if steps:
        some = np.unique(np.linspace(0, steps - 1, min(steps, _PAIRS)).round().astype(int)).tolist()
        pairs = [(film.at(film.seconds[frame]), film.at(film.seconds[frame + 1])) for frame in some]
        total += steps * sum(_changed_bytes(*pair) for pair in pairs) // len(pairs)
    return total * _TEXT if path.suffix == ".usda" else total


def _changed_bytes(before: Gaussians | None, points: Gaussians) -> int:
    fields = {name: getattr(points, name) for name in _NAMES}
    return sum(
        field.nbytes
        for name, field in fields.items()
        if before is None or not np.array_equal(getattr(before, name), field)
    )


def _set_frame(splats: Any, frame: int, before: Gaussians | None, points: Gaussians) -> None:
    from pxr import UsdGeom  # pyright: ignore[reportMissingImports] - optional

    for name, kind in _kinds().items():
        old, new = None if before is None else getattr(before, name), getattr(points, name)
        if old is not None and np.array_equal(old, new):
            continue
        attribute = _attribute(splats, _NAMES[name])
        if old is None:
            attribute.Set(kind.FromNumpy(_stored(name, new)))
        else:
            attribute.Set(kind.FromNumpy(_stored(name, old)), frame - 1)
        attribute.Set(kind.FromNumpy(_stored(name, new)), frame)
    spread = _SHOWN * points.scales.max(1, keepdims=True)
    around = points.means - spread, points.means + spread
    low, high = (around[0].min(0), around[1].max(0)) if len(points) else (np.zeros(3), np.zeros(3))
    ends = [tuple(end.tolist()) for end in (low, high)]
    extent = _attribute(splats, "Extent")
    if before is None:
        _attribute(splats, "RadianceSphericalHarmonicsDegree").Set(points.sh_degree)
        harmonics = UsdGeom.Primvar(_attribute(splats, _NAMES["sh"]))
        harmonics.SetInterpolation(UsdGeom.Tokens.vertex)
        harmonics.SetElementSize(points.sh.shape[1])
        extent.Set(ends)
    extent.Set(ends, frame)


def _kinds() -> dict[str, Any]:
    """Return the array type of each field of Gaussians."""
    from pxr import Vt  # pyright: ignore[reportMissingImports] - optional

    vectors = Vt.Vec3fArray
    return {
        "means": vectors,
        "quats": Vt.QuatfArray,
        "scales": vectors,
        "opacities": Vt.FloatArray,
        "sh": vectors,
    }


def _stored(name: str, values: np.ndarray) -> np.ndarray:
    """Return a field as USD has it in memory: rotations are xyzw, harmonics [N * K, 3]."""
    if name == "quats":
        return np.ascontiguousarray(np.roll(values, -1, axis=1))
    return values.reshape(-1, 3) if name == "sh" else values


def _attribute(splats: Any, name: str) -> Any:
    return getattr(splats, f"Create{name}Attr")()
