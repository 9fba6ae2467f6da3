"""All settings of a reconstruction, in sections.

Each declares its type, its range, its default and when it has an effect,
its value in the paper, and the measurements by which its default was chosen. `benchmarks/settings_page.py` writes tables of them.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

from splatreel.base.errors import UsageError
from splatreel.config.setting_values import Bits, Chosen, Count, Crf, Needs, Paper, Range, Share, Weight, check

PAPER_WIDTH = 1352
"""Image width in pixels that the thresholds of flow and gradients refer to, as in the paper."""

HISTORY, EXPERIMENTS = "history/0.1.md#", "experiments/"
"""Beginnings of the addresses of measurements, in docs/."""
DETAIL = EXPERIMENTS + "2026-11-27-detail.md"
PARTS = HISTORY + "what-the-parts-are-worth"
DEFAULTS = HISTORY + "measured-while-choosing-the-defaults-of-standard"
HALF_SIZE = HISTORY + "half-size-starts-means-of-the-last-iterations-and-what-did-not-pay"
SHADE = HISTORY + "shade-antialiasing-rounds"
FLOATERS = HISTORY + "floaters-a-third-film-and-a-price-for-opacity"
PAPERS_CODEC = HISTORY + "the-papers-codec-complete-and-its-tables"

SEPARATED = Needs("layering.enabled", (True,))
ADAPTED = Needs("layering.adapt_every", but=(0,))


@dataclass(frozen=True)
class LayeringConfig:
    """Settings of motion layering (paper section 4.1): the separation of dynamic points from static points, which are stored once."""

    enabled: bool = True
    """Separate static from dynamic points; otherwise all points move, as in config. 1 of the paper's Table 8."""
    flow: Annotated[
        Literal["dis", "raft"],
        Needs("layering.enabled", (True,), other=Needs("group.tracks", (True,))),
        Chosen(
            "basketball, frames 30 to 59, and juggle; end points on training cameras",
            EXPERIMENTS + "2026-11-26-gmflow.md",
        ),
    ] = "dis"
    """Optical flow: dis is part of OpenCV; raft needs weights that you provide."""
    segment: Annotated[Literal["grabcut", "sam2", "none"], SEPARATED] = "none"
    """Segmentation that completes motion masks to whole objects; sam2 needs weights that you provide."""
    flow_frames: Annotated[Count, SEPARATED, Chosen("basketball 160x90", PARTS)] = 7
    """Number of frames of the group that flow is computed to; the paper uses 1, the next keyframe."""
    lift: Annotated[Literal["optimize", "vote"], SEPARATED] = "vote"
    """Method that turns masks into labels of points: the paper's optimization of rendered labels, or votes by each point's share in
    the masks."""
    adapt_every: Annotated[int, Range(0), Paper("iterations between conversions")] = 100
    """Iterations between two adaptive conversions of static points to dynamic ones; 0 turns off conversion, cloning and pruning."""
    adapt_changed_share: Annotated[
        Share,
        ADAPTED,
        SEPARATED,
        Chosen("basketball, built-in, dominoes", HISTORY + "conversion-where-nothing-changes", seeds="0, some 1"),
    ] = 0.3
    """Share of a static point's visible area that must lie where images of the group change for the point to be converted. 0 converts
    anywhere, as the paper does."""
    relighting: Annotated[
        bool,
        SEPARATED,
        Chosen("built-in, basketball, juggle, kitchen, yard, dominoes", HISTORY + "shadows", seeds="0, some 1"),
    ] = True
    """Put static points whose light changes into the group, so that their colors can follow."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "layering.")


FEWEST_ITERATIONS, MOST_ITERATIONS = 1000, 4000
"""Range of the iterations of a first keyframe that the number of frames decides."""
ITERATIONS_PER_FRAME = 7.5
"""Iterations of a first keyframe that each frame of the video adds. They take a tenth to a fifth of all time, at any length."""


@dataclass(frozen=True)
class KeyframeConfig:
    """Settings of the static reconstruction of a group's first frame (3DGS, paper section 5.1)."""

    first_iterations: Annotated[
        int,
        Range(0),
        Paper("iterations, first keyframe", standard="1000, and 7.5 for each frame of the video, at most 4000"),
        Chosen("built-in, basketball at two sizes", DETAIL, seeds="0, 1"),
    ] = 0
    """Iterations of the first keyframe, which starts from sparse points. 0 decides by the number of frames: its static points are
    stored once, so a longer video affords better ones."""
    refine_iterations: Annotated[Count, Paper("iterations, later keyframes")] = 400
    """Iterations of later keyframes, which start from the last group."""
    coarse_share: Annotated[Share, Chosen("built-in, basketball at two sizes", DETAIL, seeds="0, 1")] = 0.35
    """Share of the iterations of the first keyframe that use half-size images."""
    temporal_mean: Annotated[bool, Chosen("dominoes, basketball, built-in", FLOATERS, seeds="0, some 1")] = True
    """Train on the mean of the group's images where nothing moves, which has less noise."""
    rate_scale: Annotated[
        float,
        Range(1e-3),
        Paper("learning rates of keyframes, as a multiple of those of 3DGS"),
        Chosen("built-in, basketball, flame_steak", HISTORY + "bolder-rates-closer-knots", seeds="0, some 1"),
    ] = 4.0
    """Factor on the learning rates of 3DGS, which are for 30,000 iterations. The higher SH bands keep theirs."""
    far_step_scale: Annotated[
        float,
        Range(1),
        Chosen(
            "kitchen, yard, dominoes, built-in, basketball",
            HISTORY + "what-is-far-and-what-hangs-in-mid-air",
            seeds="0, some 1",
        ),
    ] = 8.0
    """Largest factor on the position steps of points beyond the typical viewing distance."""
    sh_degree: Annotated[int, Range(0, 3), Paper("SH degree"), Chosen("basketball 160x90", PARTS)] = 3
    """Degree of the spherical harmonics of view-dependent color."""
    max_points: Annotated[Count, Chosen("flame_steak", HALF_SIZE)] = 60_000
    """Maximum number of points of the first keyframe."""
    points_per_pixel: Annotated[Weight, Chosen("dominoes", FLOATERS)] = 0.6
    """Maximum number of points per pixel of one image. Small images cannot tell more points apart."""
    lambda_opacity: Annotated[
        Weight, Chosen("dominoes, basketball, built-in, flame_steak", FLOATERS, seeds="0, some 1")
    ] = 0.01
    """Weight of opacities after densification, per pixel of an image, so that points that explain little fade."""
    lambda_spread: Annotated[
        Weight,
        Chosen(
            "dominoes, basketball, built-in, flame_steak; its form also cove, kitchen, yard, juggle, studio",
            HISTORY + "nothing-before-a-surface",
            HISTORY + "mist-before-plain-walls",
            seeds="0, some 1",
        ),
    ] = 1.0
    """Weight of floaters: opacity in front of the surface that a pixel shows, by its distance in log depth."""
    lambda_roughness: Annotated[
        Weight,
        Chosen(
            "yard (seeds 0, 2 to 5), dominoes, built-in and basketball with fewer cameras",
            HISTORY + "few-cameras-plates-before-plain-walls",
            seeds="0, some 1 to 5",
        ),
    ] = 0.3
    """Weight of bends in depth where an image is plain. With few cameras, nothing else determines the distance of a wall."""
    detail: Annotated[
        bool,
        Chosen(
            "basketball at three sizes, built-in",
            DETAIL,
            EXPERIMENTS + "2026-11-27-plain-walls.md",
            EXPERIMENTS + "2026-11-27-long-axis-splits.md",
            EXPERIMENTS + "2026-11-28-pruning-and-view-scores.md",
            seeds="0, 1, some 2",
        ),
    ] = True
    """Densify the first keyframe by absolute gradients, and add points in the pixels that differ most from the images."""
    densify_every: Count = 100
    """Iterations between two densifications."""
    average_share: Annotated[Share, Chosen("flame_steak, built-in, basketball, yard, dominoes", HALF_SIZE)] = 0.1
    """Share of the iterations, the last ones, whose mean is kept instead of the last state."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "keyframe.")

    def for_video(self, frames: int) -> KeyframeConfig:
        """Return the settings for a video of a number of frames, 0 if it is not known: `first_iterations` is decided."""
        decided = min(round(FEWEST_ITERATIONS + ITERATIONS_PER_FRAME * frames), MOST_ITERATIONS)
        return replace(self, first_iterations=self.first_iterations or decided)


Deformation = Literal["trajectory", "hashgrid"]


@dataclass(frozen=True)
class GroupConfig:
    """Settings of the motion of dynamic points within a group (paper section 4.2)."""

    length: Annotated[
        Count,
        Paper("group length", "MeetRoom 20"),
        Chosen("basketball, studio", HALF_SIZE, HISTORY + "a-scarf-that-turns-and-motion-that-is-handed-on"),
    ] = 30
    """Frames of a group without the overlap."""
    overlap: Annotated[int, Range(0), Paper("overlap")] = 5
    """Frames that a group shares with the next one, in which the two cross-fade; less than length."""
    deformation: Annotated[
        Deformation, Chosen("basketball 160x90, built-in", PARTS, HISTORY + "the-first-whole-runs")
    ] = "trajectory"
    """Model of motion: a spline for each point, or the paper's 4D hash grid."""
    iterations_per_frame: Annotated[
        Count, Paper("iterations of a group, for each frame"), Chosen("built-in, basketball", SHADE)
    ] = 110
    """Training iterations for each frame of the group, overlap included."""
    coarse_share: Annotated[Share, Chosen("built-in, basketball at two sizes", HALF_SIZE)] = 0.25
    """Share of the iterations that use half-size images."""
    lambda_arap: Annotated[Weight, Paper("lambda_arap"), Chosen("basketball", DEFAULTS)] = 0.01
    """Weight of as-rigid-as-possible motion (lambda_arap)."""
    lambda_temporal: Annotated[Weight, Paper("lambda_temp")] = 0.01
    """Weight of smooth motion over time (lambda_temp)."""
    tracks: Annotated[bool, Chosen("basketball, built-in", DEFAULTS, PARTS)] = True
    """Start from optical flow tracks, and add points where several views show something new."""
    appearance: Annotated[bool, Chosen("built-in, basketball", SHADE)] = True
    """Let color and opacity of dynamic points change slowly within a group."""
    time_offsets: Annotated[bool, Chosen("studio, basketball", HISTORY + "cameras-out-of-step")] = True
    """Learn by how many frames each camera is late."""
    faint_share: Annotated[Share, Chosen("built-in, basketball", HISTORY + "bounces-and-shadows")] = 0.01
    """Share of all blending weight. Twice during training, the faintest points that hold this share together are removed. 0 keeps
    all."""
    lambda_sh: Annotated[
        Weight,
        Needs("keyframe.sh_degree", but=(0,)),
        Chosen(
            "built-in, basketball",
            HISTORY + "what-view-dependent-colour-costs-and-learning-with-the-codecs-noise",
            seeds="0, basketball also 1",
        ),
    ] = 0.05
    """Weight of the higher SH bands' magnitude, per pixel of an image. These bands learn mostly noise on moving things, which show
    each camera another pose."""
    progressive_share: Annotated[
        Share,
        Paper("progressive sampling, share of training", standard="tracks initialize motion"),
        Chosen("basketball at two sizes", DEFAULTS),
    ] = 0.0
    """Share of the iterations over which frames are added one by one; 0 uses all frames from the start."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "group.")
        if self.overlap >= self.length:
            raise UsageError(
                f"group.overlap {self.overlap} does not fit group.length {self.length}. "
                "Choose an overlap shorter than a group."
            )


Rate = Literal["high", "medium", "low"]
COARSENESS: dict[Rate, float] = {"high": 0.3, "medium": 0.65, "low": 2.5}
"""Coarseness of each rate of the predictive codec, best first. The rate low has about half of the bytes of medium."""
Codec = Literal["predictive", "h265"]
Source = Literal["ofs", "ori", "dif", "raw"]


PREDICTIVE = Needs("encode.codec", ("predictive",))
QUANTIZED = Needs("encode.h265.crf_attributes", (None,))
FILMED = Needs("encode.h265.source", ("ofs", "ori", "dif"))


@dataclass(frozen=True)
class H265Config:
    """Settings of the paper's codec (section 4.3, Tables 9 and 10). Bits of none store float32, as the tables' dashes do."""

    position_bits: Annotated[Annotated[int, Range(4, 21)] | None, Paper("QP_DRC", "Technicolor 14")] = 20
    """Bits of a coordinate (QP_DRC); none stores float32 without Draco."""
    quat_bits: Annotated[Bits | None, Paper("bits of q")] = 8
    """Bits of a component of a quaternion."""
    opacity_bits: Annotated[Bits | None, QUANTIZED, Paper("bits of o")] = 8
    """Bits of an opacity."""
    scale_bits: Annotated[Bits | None, QUANTIZED, Paper("bits of s")] = 12
    """Bits of a scale."""
    log_scales: Annotated[bool, Chosen("built-in, basketball", PAPERS_CODEC)] = True
    """Quantize base 2 logarithms of the scales; the paper quantizes the scales themselves."""
    color_bits: Annotated[Bits | None, QUANTIZED, Paper("bits of c_base")] = 8
    """Bits of a component of c_base, and of the codebook of c_rest."""
    weighted_codebook: Annotated[
        bool, QUANTIZED, Needs("encode.sh_entries", but=(None, 0)), Chosen("built-in, basketball", PAPERS_CODEC)
    ] = True
    """Weight points by their importance in the codebook of c_rest; in the paper all points count alike."""
    source: Source = "ofs"
    """Coded form of the motion (Table 10): ofs, offsets; ori, positions and rotations; dif, differences from frame to frame; raw,
    offsets as float32. The web player plays ofs only."""
    crf: Annotated[Crf, FILMED, Paper("CRF_265", "Technicolor 14")] = 20
    """CRF_265 of the low byte of dx, and of dq: the quality of their video. Lower is better and larger."""
    crf_attributes: Crf | None = None
    """CRF of a video of scales, opacities and colors with 8 bits, as in V3; none quantizes them as in the paper."""
    fold: Annotated[bool, FILMED, Chosen("built-in, basketball", PAPERS_CODEC)] = True
    """Mirror the low byte where the high byte is odd, so that it follows a triangle wave instead of a sawtooth."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "encode.h265.")


@dataclass(frozen=True)
class EncodeConfig:
    """Settings of the codec of a reel: the predictive codec, or the paper's codec."""

    codec: Annotated[
        Codec,
        Chosen("built-in, basketball", HISTORY + "shapes-in-six-numbers-places-as-finely-as-they-show-columns-by-size"),
    ] = "predictive"
    """Codec: predictive, or h265 as in the paper, which has settings of its own."""
    coarseness: Annotated[
        float,
        Range(1e-3),
        PREDICTIVE,
        Needs("encode.renditions", ((),)),
        Chosen(
            "built-in, basketball, kitchen; the steps also juggle and studio",
            EXPERIMENTS + "2026-11-25-finer-steps.md",
            EXPERIMENTS + "2026-11-26-steps-by-slope.md",
        ),
    ] = 0.65
    """Factor on all quantization steps of the predictive codec. A reconstruction chooses its steps for the default. Higher is
    smaller and worse."""
    renditions: Annotated[tuple[Rate, ...], PREDICTIVE] = ()
    """Rates of the predictive codec that every group is written in, best first, instead of a coarseness. Layers have the best one."""
    sh_entries: Annotated[
        Annotated[int, Range(0, 65536)] | None,
        Needs("encode.codec", ("h265",), always=(0,)),
        Needs("encode.h265.crf_attributes", (None,), always=(0,)),
        Needs("keyframe.sh_degree", but=(0,)),
        Paper("N_vq"),
        Chosen("a Neu3DV frame", HISTORY + "the-first-whole-runs"),
    ] = 1024
    """Size of the codebook of view-dependent color in the h265 codec; none codes each point's own. 0 drops this color in both
    codecs."""
    h265: Annotated[H265Config, Needs("encode.codec", ("h265",))] = field(default_factory=H265Config)
    """Settings of the paper's codec."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "encode.")

    def with_h265(self, **values: Any) -> EncodeConfig:
        """Return the settings with other values of the paper's codec."""
        return replace(self, h265=replace(self.h265, **values))

    def rendition(self, rate: Rate) -> EncodeConfig:
        """Return the settings that one of the renditions is encoded with."""
        return replace(self, coarseness=COARSENESS[rate], renditions=())


@dataclass(frozen=True)
class Config:
    """All settings that decide the result of a reconstruction.

    The defaults are `--quality standard`. The settings are saved beside the checkpoints, so that a run is continued only with the
    same ones.

    Raises:
        UsageError: A value is out of range.
    """

    layering: LayeringConfig = field(default_factory=LayeringConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    group: GroupConfig = field(default_factory=GroupConfig)
    encode: EncodeConfig = field(default_factory=EncodeConfig)
    correct_colors: Annotated[bool, Chosen("basketball 160x90", PARTS)] = True
    """Learn a color gain for each training camera, with a mean of one. Cameras that were never seen need none."""
    check_poses: Annotated[
        bool,
        Chosen("built-in; checked on basketball, the films and a Neu3DV frame", HISTORY + "cameras-that-do-not-fit"),
    ] = True
    """Correct the poses of cameras that were moved after their calibration, and leave out cameras that show something else."""
    check_coverage: Annotated[
        bool,
        Chosen(
            "basketball with 4 and 8 cameras", HISTORY + "what-to-expect-of-new-views-and-calibrations-that-cannot-be"
        ),
    ] = True
    """Predict the quality of novel views by a quick trial without one camera, before training. The reel limits its views if the
    trial fails."""
    even_exposure: Annotated[
        bool,
        Chosen(
            "studio, basketball; light: built-in",
            HISTORY + "twenty-phones-exposures-that-change",
            HISTORY + "light-that-changes-for-all-cameras",
        ),
    ] = True
    """Remove changes of the cameras' exposures and of the scene's light from the images. The light is restored when the reel is
    played."""
    antialias: Annotated[bool, Chosen("built-in, basketball", SHADE)] = True
    """Draw splats thinner than a pixel fainter (Mip-Splatting), so that the scene looks the same at any image size."""
    background: Annotated[
        bool,
        Chosen(
            "basketball with 10 cameras, dominoes with 8, built-in with 6, yard",
            HISTORY + "doubts-room-before-a-viewer-and-a-background",
            seeds="0, some 1",
        ),
    ] = True
    """Fill places that no camera has seen with the color of the images' borders instead of black."""
    training_megapixels: Annotated[
        float, Range(0), Chosen("kitchen at 1352x1014", EXPERIMENTS + "2026-11-25-a-megapixel.md")
    ] = 0.7
    """Mean megapixels per training iteration. Larger images train mostly on downscaled copies, since neighboring pixels tell nearly
    the same. 0 trains at full size, except for the coarse share."""
    chapter_frames: Annotated[
        int,
        Range(0),
        Chosen("basketball, built-in, studio; at draft, one row at standard", EXPERIMENTS + "2026-11-25-chapters.md"),
    ] = 300
    """Frames of a chapter. A video longer than one and a half chapters gets static points that all chapters share; its chapters
    then train independently, on several machines if there are any. 0 makes one chapter."""
    region: str = ""
    """Volume to make a reel of, as `splatreel edit` takes it: box:x,y,z,X,Y,Z, sphere:x,y,z,RADIUS, cylinder:x,y,z,RADIUS,HEIGHT or
    capture. Its surroundings are trained coarsely and left out of the reel. Empty for everything."""
    seed: Annotated[int, Range(0)] = 0
    """Seed of all random numbers."""

    def __post_init__(self) -> None:
        """Check the values."""
        check(self, "")

    def for_video(self, frames: int) -> Config:
        """Return the settings for a video of a number of frames, see `KeyframeConfig.for_video`."""
        return dataclasses.replace(self, keyframe=self.keyframe.for_video(frames))

    def to_json(self) -> str:
        """Return the settings as JSON."""
        return json.dumps(dataclasses.asdict(self), indent=1, sort_keys=True)
