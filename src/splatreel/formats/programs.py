"""Programs that read files of Gaussians, with what their readers accept, from their sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

FrameKind = Literal["ply", "compressed-ply", "splat", "sog", "spz", "spz2", "spz4", "glb"]
"""Formats of files of one frame, by the name that `splatreel export --format` takes."""
ProgramName = Literal[
    "unity", "blender", "blender-kiri", "blender-4dgs", "unreal", "supersplat", "three", "spark", "babylon"
]


@dataclass(frozen=True)
class Program:
    """A program that reads files of Gaussians.

    Attributes:
        name: Name of the program.
        formats: Formats of `FRAME_FORMATS` that it reads, the best first.
        degree: The only degree of spherical harmonics that it reads correctly; None for any.
        reads_double: True if positions may be stored as double.
        equal_counts: True if all files of a sequence need the same number of Gaussians in the same order.
    """

    name: str
    formats: tuple[FrameKind, ...]
    degree: int | None = None
    reads_double: bool = True
    equal_counts: bool = False


PROGRAMS: dict[ProgramName, Program] = {
    # aras-p/UnityGaussianSplatting, package/Editor/Utils. SPZFileReader.cs: "header version unexpected" for any version but 2; it reads
    # 15 coefficients per point whatever the degree. PLYFileReader.cs and GaussianFileReader.cs: binary little endian, x to rot_3 must
    # be float; f_rest_N is taken as one of 45, so that degrees 1 and 2 are misread.
    # HankunYu/Unity4DGS, Assets/4DGS/Editor/Utils, has the same readers; Runtime/GaussianPlayer.cs plays assets by the order of names.
    # HiFi-Human/DynGsplat-unity, CompressScripts/compress.py, compresses sequences of PLY files with equal counts.
    "unity": Program("UnityGaussianSplatting", ("ply", "spz2"), degree=3, reads_double=False, equal_counts=True),
    # ReshotAI/gaussian-splatting-blender-addon, blender-addon/__init__.py: the f_rest columns are reshaped to (N, 3, 15), which fails
    # for degrees 1 and 2. Blender stores positions as float.
    "blender": Program("ReshotAI's Blender add-on", ("ply",), degree=3, reads_double=False),
    # Kiri-Innovation/3dgs-render-blender-addon, src/import_ply.py: Blender's own PLY importer, whose positions are float; harmonics are
    # optional.
    "blender-kiri": Program("KIRI's Blender add-on 3DGS Render", ("ply",), reads_double=False),
    # AnantakSingh/Simple-4DGS-viewer-editor-for-Blender, convert.py: PLY files whose names end in a number, any counts and types.
    "blender-4dgs": Program("the Blender add-on Simple 4DGS viewer", ("ply",)),
    # TimChen1383/NanoGaussianSplatting, PLYFileReader.cpp: binary little endian, all degrees; every property is read as a float where
    # it starts, so that doubles are misread.
    # YuanBaoSMadLab/OpenSplat4D, which contains it: GaussianSplatAssetFactory.cpp, ImportPLYSequence refuses files with other counts of
    # vertices than the first, sorts them by name, and interpolates; harmonics above degree 0 are those of the first file.
    "unreal": Program("the Unreal plugins OpenSplat4D and NanoGS", ("ply",), reads_double=False, equal_counts=True),
    # playcanvas/supersplat, src/io/read/loader.ts: all formats of splat-transform. A folder of PLY files is an animation.
    "supersplat": Program("SuperSplat", ("ply", "sog", "compressed-ply", "spz", "spz2", "splat")),
    # mrdoob/three.js, examples/jsm/loaders. SPZLoader.js: versions 1 to 3, degrees up to 3. GaussianSplatPLYLoader.js, SPLATLoader.js.
    "three": Program("three.js", ("spz", "spz2", "ply", "splat")),
    # sparkjsdev/spark, rust/spark-lib/src/spz.rs: versions 1 to 3. ply.rs: all types. src/pcsogs.ts: SOG 2.
    "spark": Program("Spark", ("spz", "spz2", "sog", "ply", "splat")),
    # BabylonJS/Babylon.js, packages/dev/loaders. SPLAT/spz.ts: versions 2 and 3. glTF/2.0/Extensions/KHR_gaussian_splatting.ts.
    "babylon": Program("Babylon.js", ("spz", "spz2", "glb", "ply", "splat")),
}
"""Programs by the name that `splatreel export --for` takes."""
