"""Design of the benchmark: cells, each one condition with common frames for every detector.

The design is a grid of marker side by noise, and sweeps of one factor at a time around the base cell (30 px,
noise 5). Where a cell does not fix the blur, each camera has its own, spread over 0.5 to 1.5 px, which no
detector knows.

Some sweeps hold other factors at special values. Those of the lens's blur have a sharp Gaussian beside it. A
drawing has no blur and plain ground. Spatially varying blur needs a tilt. The bound is always that of the raw
pixels: processing in the camera can only lose information.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

BLURS_PX = (0.5, 1.5)
"""Least and greatest standard deviation of the lens's blur, px, where a cell leaves it to the camera."""

MIDDLE_GREY = 130.0
"""Mean of a marker's black and white, grey levels: 30 and 230 at full contrast, 200, so that noise is not
clipped."""

GROUND_GREY = 128.0
"""Mean grey level of the ground, except in drawings."""

MAX_MARKERS = 16
"""Maximum number of markers in an image: a grid of four by four."""

SMALL_IMAGES_PX = 40.0
"""Marker side, px, up to which images have 640x480 pixels instead of 1280x960."""


NO_FACTORS = ("blur_px", "markers", "cameras", "frames")
"""Fields of a cell that its rows omit: they state the sample size, or have their own columns."""


@dataclass(frozen=True)
class Cell:
    """One condition of the benchmark.

    Attributes:
        sweep: the series it belongs to; `base` belongs to all of them.
        side_px: side of the black square at the image's centre.
        noise: standard deviation of the sensor's noise, grey levels.
        blur_px: standard deviation of the lens's blur; None: of each camera's own.
        motion_px: length of the streak that the exposure makes of a point, in a direction drawn per frame.
        contrast: white minus black, grey levels.
        tilt_deg: angle between optical axis and vertical, in a direction drawn per camera.
        uneven: change of the light from one side of the image to the other, as a share of its mean.
        occlusion: share of each marker's square that a dark disc about one of its corners covers.
        clutter: dark quadrilaterals in view.
        touching: side of black squares that touch the markers' corners, as on AprilGrid boards, in marker
            sides.
        plain: True if the ground is as white as the cards, without texture, as in a drawing.
        disc_px: radius of the disc of defocus, beside the Gaussian.
        coma_px: C of the lens's coma, in a direction drawn per camera.
        defocus_px: radius of the disc in the image corner that is farthest out of focus; the middle is in
            focus, so that it needs a tilt.
        gamma: of the camera's tone curve.
        white_balance: gain of the red and blue pixels of a mosaic of colour filters; 0 for no filters.
        denoise: grey levels that a bilateral filter takes for noise.
        sharpen: amount of an unsharp mask.
        jpeg: quality of a JPEG; None for none.
        h264: constant rate factor of a video; None for none.
        shrink: factor by which a scaler shrinks the camera's images, by means over boxes of so many pixels.
            Markers have `side_px` afterwards; noise and the camera's blur are those of the pixels before.
        markers: in an image; fewer if more would not fit.
        cameras: each with its own blur, ground and team.
        frames: consecutive images of each camera.
    """

    sweep: str = "base"
    side_px: float = 30.0
    noise: float = 5.0
    blur_px: float | None = None
    motion_px: float = 0.0
    contrast: float = 200.0
    tilt_deg: float = 0.0
    uneven: float = 0.0
    occlusion: float = 0.0
    clutter: int = 0
    touching: float = 0.0
    plain: bool = False
    disc_px: float = 0.0
    coma_px: float = 0.0
    defocus_px: float = 0.0
    gamma: float = 1.0
    white_balance: float = 0.0
    denoise: float = 0.0
    sharpen: float = 0.0
    jpeg: int | None = None
    h264: int | None = None
    shrink: float = 1.0
    markers: int = MAX_MARKERS
    cameras: int = 6
    frames: int = 12

    @property
    def black(self) -> float:
        """Grey level of the markers' black."""
        return MIDDLE_GREY - self.contrast / 2

    @property
    def white(self) -> float:
        """Grey level of the card."""
        return MIDDLE_GREY + self.contrast / 2

    @property
    def ground(self) -> float:
        """Mean grey level of the ground."""
        return self.white if self.plain else GROUND_GREY

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images, px; small markers have small images, which take less time."""
        return (640, 480) if self.side_px <= SMALL_IMAGES_PX else (1280, 960)

    def blur_of(self, camera: int) -> float:
        """Return the blur of one camera, px: the cell's, or one of an even spread over `BLURS_PX`."""
        if self.blur_px is not None:
            return self.blur_px
        return float(np.interp((camera + 0.5) / self.cameras, (0, 1), BLURS_PX))

    def factors(self) -> dict[str, float | int | str | None]:
        """Return the cell's factors by name for the result's rows; the blur is each camera's."""
        return {key: value for key, value in asdict(self).items() if key not in NO_FACTORS}


@dataclass(frozen=True)
class Sweep:
    """One factor of the design and its values, beside the one that it has in the base cell.

    Attributes:
        name: name of the sweep.
        key: field of `Cell` that is varied.
        label: label of the factor on axes, with its unit.
        values: values of the factor.
        fixed: other factors that differ from the base cell, which then does not belong to the series.
    """

    name: str
    key: str
    label: str
    values: tuple[float, ...]
    fixed: Mapping[str, Any] = field(default_factory=dict)


SWEEPS = (
    Sweep("blur", "blur_px", "blur (px)", (0.5, 0.8, 1.1, 1.5, 2.0)),
    Sweep("motion", "motion_px", "motion blur (px)", (1.0, 2.0, 4.0)),
    Sweep("contrast", "contrast", "contrast (grey levels)", (40.0, 80.0, 140.0)),
    Sweep("tilt", "tilt_deg", "tilt (deg)", (5.0, 15.0, 30.0, 45.0, 50.0, 60.0, 70.0)),
    Sweep("uneven", "uneven", "change of light over the image", (0.3, 0.6)),
    Sweep("occlusion", "occlusion", "share of the marker covered", (0.005, 0.02, 0.05, 0.1)),
    Sweep("clutter", "clutter", "dark quadrilaterals in view", (50, 150)),
    Sweep("touching", "touching", "black squares at the corners (sides)", (0.15, 0.3, 0.5)),
    Sweep("drawing", "noise", "noise of a drawing without blur", (0.0, 2.0), {"blur_px": 0.0, "plain": True}),
)
"""Sweeps of the full design over scene and sensor, a series of cells each."""

SHARP_LENS = {"blur_px": 0.5}
"""Gaussian beside another lens blur, small so that the other dominates."""

CONSUMER = {
    "blur_px": 0.6,
    "disc_px": 0.6,
    "coma_px": 0.2,
    "gamma": 2.2,
    "white_balance": 1.8,
    "denoise": 6.0,
    "sharpen": 0.6,
    "h264": 23,
}
"""A typical consumer camera, about as in the scenario `star-consumer`."""

CAMERA_SWEEPS = (
    Sweep("disc", "disc_px", "disc of defocus, radius (px)", (1.0, 2.0, 3.0), SHARP_LENS),
    Sweep("coma", "coma_px", "coma C (px)", (0.5, 1.0, 2.0), SHARP_LENS),
    Sweep(
        "defocus", "defocus_px", "disc in the corner, tilt 20° (px)", (1.0, 2.0, 3.0),
        {**SHARP_LENS, "tilt_deg": 20.0},
    ),
    Sweep("gamma", "gamma", "gamma", (1.8, 2.4)),
    Sweep("bayer", "white_balance", "Bayer mosaic, white balance", (1.0, 2.0)),
    Sweep("denoise", "denoise", "denoising (grey levels)", (5.0, 10.0, 20.0)),
    Sweep("sharpen", "sharpen", "sharpening, amount", (0.5, 1.0, 2.0)),
    Sweep("jpeg", "jpeg", "JPEG quality", (95, 80, 50)),
    Sweep("h264", "h264", "H.264, rate factor", (18, 28, 38)),
    Sweep("scaler", "shrink", "shrunk by a scaler's box (px)", (1.5, 2.0, 2.7)),
    Sweep("consumer", "side_px", "side through a whole camera (px)", (16.0, 24.0, 40.0), CONSUMER),
)  # fmt: skip
"""Sweeps over lens and processing."""

QUICK_VALUES: dict[str, tuple[float, ...]] = {
    "blur": (0.5, 1.5),
    "motion": (2.0,),
    "contrast": (80.0,),
    "tilt": (15.0, 60.0),
    "uneven": (0.3,),
    "occlusion": (0.02,),
    "clutter": (150,),
    "touching": (0.3,),
    "drawing": (0.0,),
    "disc": (2.0,),
    "coma": (1.0,),
    "defocus": (2.0,),
    "gamma": (2.4,),
    "bayer": (2.0,),
    "denoise": (10.0,),
    "sharpen": (1.0,),
    "jpeg": (80,),
    "h264": (28,),
    "scaler": (1.5,),
    "consumer": (24.0,),
}
"""Values of the same sweeps for `quick_design`."""

SIDES_PX = (8, 10, 12, 14, 16, 18, 20, 24, 30, 40, 60, 80, 100)
NOISES = (2.0, 5.0, 10.0)
QUICK_SIDES_PX = (12, 16, 20, 30, 60)
"""Marker sides, px, and noises, grey levels, of the grid; in `quick_design` only the noise 5."""

GRID, EMPTY = "side x noise", "empty clutter"
"""Names of the series beside sweeps: the grid, and the images of clutter without a marker."""

QUADS = 150
"""Number of dark quadrilaterals in each image of the search for false positives."""

PER_CLUTTER = 4
"""Images of the same clutter, which differ only in their noise. Chosen: clutter is slow to make."""


def full_design(clutter_images: int = 240) -> list[Cell]:
    """Return all cells, with this many images of empty clutter for false positives."""
    return _design(Cell(), SIDES_PX, NOISES, (*SWEEPS, *CAMERA_SWEEPS), clutter_images)


def quick_design(clutter_images: int = 12) -> list[Cell]:
    """Return few cells of few frames, for a quick functional check; arguments as `full_design`."""
    sweeps = [replace(sweep, values=QUICK_VALUES[sweep.name]) for sweep in (*SWEEPS, *CAMERA_SWEEPS)]
    return _design(Cell(cameras=2, frames=3), QUICK_SIDES_PX, (5.0,), sweeps, clutter_images)


def _frames(base: Cell, side_px: float) -> int:
    """Return the images per camera; a third for large ones, which take longer and barely differ in recall."""
    return base.frames if side_px <= SMALL_IMAGES_PX else -(-base.frames // 3)


def _design(
    base: Cell,
    sides_px: Iterable[float],
    noises: Iterable[float],
    sweeps: Iterable[Sweep],
    clutter_images: int,
) -> list[Cell]:
    grid = [
        replace(base, sweep=GRID, side_px=float(side), noise=noise, frames=_frames(base, side))
        for noise in noises
        for side in sides_px
    ]
    factors = [
        replace(base, sweep=sweep.name, **{**sweep.fixed, sweep.key: value})
        for sweep in sweeps
        for value in sweep.values
    ]
    empty = replace(
        base,
        sweep=EMPTY,
        clutter=QUADS,
        markers=0,
        cameras=-(-clutter_images // PER_CLUTTER),
        frames=PER_CLUTTER,
    )
    return [base, *grid, *factors, *([empty] if clutter_images else [])]
