"""What is measured: cells, each one condition under which every detector is given the same frames.

The design is a grid of marker side by noise, and sweeps of one factor at a time around the base cell (30 px,
noise 5). Where a cell does not fix the blur, each camera has its own, spread over 0.5 to 1.5 px, which no
detector is given.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace

import numpy as np

BLURS_PX = (0.5, 1.5)
"""Least and greatest standard deviation of the lens's blur, px, where a cell leaves it to the camera."""

MIDDLE_GREY = 130.0
"""Mean of a marker's black and white, grey levels: 30 and 230 at full contrast, 200, so that noise is not
clipped."""

MOST_MARKERS = 16
"""Most markers in an image: a grid of four by four."""

SMALL_IMAGES_PX = 40.0
"""Markers up to this side, px, are shown in images of 640x480, larger ones in 1280x960."""


@dataclass(frozen=True)
class Cell:
    """One condition of the benchmark.

    Attributes:
        sweep: the series it belongs to; `base` belongs to all of them.
        side_px: side of the black square at the image's centre.
        noise: standard deviation of the sensor's noise, grey levels.
        blur_px: standard deviation of the lens's blur; None: of each camera's own.
        motion_px: length of the streak that the exposure makes of a point, in a direction drawn per frame.
        contrast: white less black, grey levels.
        tilt_deg: angle between optical axis and vertical, in a direction drawn per camera.
        uneven: change of the light from one side of the image to the other, as a share of its mean.
        occlusion: share of each marker's square that a dark disc about one of its corners covers.
        clutter: dark quadrilaterals in view.
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
    markers: int = MOST_MARKERS
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
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images, px; small markers have small images, which take less time."""
        return (640, 480) if self.side_px <= SMALL_IMAGES_PX else (1280, 960)

    def blur_of(self, camera: int) -> float:
        """Blur of one camera, px: the cell's, or one of an even spread over `BLURS_PX`."""
        if self.blur_px is not None:
            return self.blur_px
        return float(np.interp((camera + 0.5) / self.cameras, (0, 1), BLURS_PX))

    def factors(self) -> dict[str, float | int | str]:
        """The factors of the cell by name, as the result's rows have them."""
        keys = (
            "sweep",
            "side_px",
            "noise",
            "motion_px",
            "contrast",
            "tilt_deg",
            "uneven",
            "occlusion",
            "clutter",
        )
        values = asdict(self)
        return {key: values[key] for key in keys}


@dataclass(frozen=True)
class Sweep:
    """One factor of the design and its values, beside the one that it has in the base cell.

    Attributes:
        name: of the sweep.
        key: field of `Cell` that is varied.
        label: of the factor on axes, with its unit.
        values: of the factor.
    """

    name: str
    key: str
    label: str
    values: tuple[float, ...]


SWEEPS = (
    Sweep("blur", "blur_px", "blur (px)", (0.5, 0.8, 1.1, 1.5, 2.0)),
    Sweep("motion", "motion_px", "motion blur (px)", (1.0, 2.0, 4.0)),
    Sweep("contrast", "contrast", "contrast (grey levels)", (40.0, 80.0, 140.0)),
    Sweep("tilt", "tilt_deg", "tilt (deg)", (5.0, 15.0, 30.0)),
    Sweep("uneven", "uneven", "change of light over the image", (0.3, 0.6)),
    Sweep("occlusion", "occlusion", "share of the marker covered", (0.005, 0.02, 0.05)),
    Sweep("clutter", "clutter", "dark quadrilaterals in view", (50, 150)),
)
"""The sweeps of the full design, a series of cells each."""

QUICK_SWEEPS = tuple(
    replace(sweep, values=values)
    for sweep, values in zip(
        SWEEPS, ((0.5, 1.5), (2.0,), (80.0,), (15.0,), (0.3,), (0.02,), (150,)), strict=True
    )
)

"""The same sweeps with fewer values, for `--quick`."""

SIDES_PX = (8, 10, 12, 14, 16, 18, 20, 24, 30, 40, 60, 80, 100)
NOISES = (2.0, 5.0, 10.0)
QUICK_SIDES_PX = (12, 16, 20, 30, 60)
"""Marker sides, px, and noises, grey levels, of the grid; with `--quick` only the noise 5."""

GRID, EMPTY = "side x noise", "empty clutter"
"""Names of the series that are no sweeps: the grid, and the images of clutter without a marker."""

QUADS = 150
"""Number of dark quadrilaterals in each image of the search for false positives."""

PER_CLUTTER = 4
"""Images of the same clutter, which differ in their noise alone. Chosen: clutter is slow to make."""


def full_design(clutter_images: int = 240) -> list[Cell]:
    """All cells, with this many images of clutter and no marker in which false positives are counted."""
    return _design(Cell(), SIDES_PX, NOISES, SWEEPS, clutter_images)


def quick_design(clutter_images: int = 12) -> list[Cell]:
    """Few cells of few frames, to see that everything works and roughly how well; as `full_design`."""
    return _design(Cell(cameras=2, frames=3), QUICK_SIDES_PX, (5.0,), QUICK_SWEEPS, clutter_images)


def _frames(base: Cell, side_px: float) -> int:
    """Images of a camera; a third of them if large, since they take longer and hardly differ in recall."""
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
    factors = [replace(base, sweep=s.name, **{s.key: value}) for s in sweeps for value in s.values]  # type: ignore[arg-type]
    empty = replace(
        base,
        sweep=EMPTY,
        clutter=QUADS,
        markers=0,
        cameras=-(-clutter_images // PER_CLUTTER),
        frames=PER_CLUTTER,
    )
    return [base, *grid, *factors, *([empty] if clutter_images else [])]
