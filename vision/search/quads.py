"""Detection of dark quadrilaterals in an image.

The compiled search (`skyherd.vision.native`) thresholds the places of an image with many dark pixels. It
follows the boundaries of the dark regions, and filters them by the compactness of their area. It selects four
corner points on each boundary, and fits a line to each side. This module has its parameters and the sizes of
image.
"""

import math

import numpy as np

from skyherd.geometry import Array, to_points
from skyherd.vision.grey import Image, block_means
from skyherd.vision.native.library import library
from skyherd.vision.native.records import SearchParameters
from skyherd.vision.search.regions import (
    DARKER,
    SHARPENING_PX,
    SMOOTHING_PX,
    WINDOWS_PX,
    Mosaic,
    crowded_places,
)

MIN_QUAD_SIDE_PX = 7.0
"""Shortest side of a dark region, px between the centres of its outermost pixels. Chosen: a marker of 8 px,
which is half a pixel longer at either end, is the smallest that can be decoded."""

MIN_AREA_PX2 = MIN_QUAD_SIDE_PX**2 / 2
"""Smallest area within a boundary, px². Chosen: half of the smallest square's, so that tilted squares
pass."""

MIN_COMPACTNESS = 0.022
"""Smallest ratio of the area to the squared boundary length. Chosen: 0.7 of that of a rectangle whose sides
have the ratio `MAX_SIDE_RATIO`, 6 / 14², so that tilted squares pass and lines do not."""

GROWTH_PX = 0.5
"""Outward shift of the sides, px. Derived: boundaries pass through the centres of a region's outermost
pixels, half a pixel within its edge."""

ERODED_PX = 1.0
"""Inward shift of a region's sides by erosion, px. Derived: it removes one pixel."""

MAX_EROSIONS = 2
"""Erosions of the enlarged image after which regions are looked at, each by half a pixel of the image.
Chosen: they part small squares that touch at their corners, which a whole pixel would destroy."""

SHRINKS = (1, 2, 4)
"""Downsampling factors of the images in which erosion separates touching regions. Chosen: erosion breaks
bridges of two pixels in each, thus of up to eight pixels; larger factors lose most markers."""

ROUNDED_SHARE = 0.125
"""Share of a side that the line fit ignores at either end, because blur rounds the corners. Chosen: a larger
share leaves fewer points, a smaller one tilts the line."""

SIDE_END_WEIGHT = 1e-6
"""Weight of the points at the rounded ends, so that a side of a few pixels still has a line. Chosen: far
below 1, the weight of the other points."""

MIN_LENGTH_PX = 1e-12
"""Smallest divisor of a direction, px; a side of one point has no direction. Chosen."""

MIN_CROSSING = 1e-6
"""Smallest sine of the angle between adjacent sides. Chosen: quadrilaterals with more parallel sides are
rejected."""

MIN_POINTS = math.ceil(4 * MIN_QUAD_SIDE_PX / math.sqrt(2))
"""Smallest number of boundary points. Derived: a square rotated by 45 degrees has `side / sqrt(2)` boundary
pixels a side."""

MAX_SIDE_RATIO = 6.0
"""Largest ratio of a quadrilateral's sides. Derived: a tilt of 80 degrees shortens a side 5.8 times."""

MAX_AREA_MISMATCH = 0.3
"""Largest relative difference between the areas of a region and its quadrilateral. Chosen: quadrilaterals
through points of other outlines differ more."""


ENLARGEMENT = 2
"""Enlargement factor of the search for small squares. Chosen: at twice the size, a cell of 1.5 px is as wide
as the filter of `SMOOTHING_PX`; a factor of three takes more than twice the time."""


def find_quads(
    image: Image,
    known_px: Array | None = None,
    min_darkness: float = 0.0,
    shrinks: tuple[int, ...] = SHRINKS,
) -> Array:
    """Return the corners (N, 4, 2), px, of the dark quadrilaterals in a grey image (height, width).

    The corners run clockwise in the image and begin with any of the four. A quadrilateral may be found
    several times, because regions are searched as they are and after erosion. Erosion separates markers from
    dark squares that touch their corners. It is also applied to images of half and a quarter of the size,
    where it breaks wider bridges.

    Args:
        image: grey.
        known_px: (K, 4, 2) corners of known squares, px, to exclude in order to save time. Measured for
            markers of 8 to 20 px at a distance of 1.6 sides from known ones: as many are found as without.
        min_darkness: as in `crowded_places`. Measured under typical blur, as a share of the contrast: at
            least 0.075 for squares of 9 px or more, and 0.05 for squares of 8 px.
        shrinks: downsampling factors of the images that are searched.
    """
    found = [np.zeros((0, 4, 2))]
    for shrink in shrinks:
        small = image if shrink == 1 else block_means(image, shrink)
        middle = (shrink - 1) / 2
        known = None if known_px is None else (known_px - middle) / shrink
        mosaic = crowded_places(small, known, min_darkness)
        if mosaic is not None:
            erosions = range(2) if shrink == 1 else range(1, 2)
            found.append(shrink * quads_of_places(mosaic, erosions) + middle)
    return np.concatenate(found)


def find_small_quads(image: Image, known_px: Array) -> Array:
    """Return the corners (N, 4, 2), px, of dark quadrilaterals outside known squares, at twice the size.

    The filters of `find_quads` lose the smallest markers and some faint ones. This search covers places with
    many dark pixels and takes three times as long.

    Args:
        image: grey, (height, width).
        known_px: (K, 4, 2) corners of the known squares, px. Some quadrilaterals may belong to one.
    """
    places = crowded_places(image, known_px)
    return np.zeros((0, 4, 2)) if places is None else small_quads(places)


def small_quads(mosaic: Mosaic) -> Array:
    """Return the corners (N, 4, 2), px, of dark quadrilaterals in enlarged parts of an image.

    Relative to the enlarged image, the smoothing filters are half as wide. Cells of 1.5 px stay separate from
    the surroundings, and narrow quadrilaterals stay whole.
    """
    enlarged = quads_of_places(mosaic, range(MAX_EROSIONS + 1), ENLARGEMENT)
    return (enlarged + 0.5) / ENLARGEMENT - 0.5


def quads_of_places(mosaic: Mosaic, erosions: range, enlargement: int = 1) -> Array:
    """Return the corners (N, 4, 2), px, of the quadrilaterals in a mosaic after each number of erosions.

    The mosaic is enlarged by a factor, 1 or 2, before it is searched. Corners count in the enlarged image.
    """
    parameters = search_parameters(erosions, enlargement)
    corners, columns = library().quads(np.ascontiguousarray(mosaic.image), mosaic.mask, parameters)
    shifts = to_points(mosaic.shifts((columns // enlargement).astype(float)))[:, None]
    return np.asarray(corners + enlargement * shifts)


def search_parameters(erosions: range, enlargement: int = 1) -> SearchParameters:
    """Return the parameters of the compiled search.

    Args:
        erosions: numbers of erosions after which regions are searched.
        enlargement: factor by which the image is enlarged, which scales the limit of the area. The limits of
            sides and boundaries count in the enlarged image.
    """
    return SearchParameters(
        growth_px=GROWTH_PX,
        eroded_px=ERODED_PX,
        min_area_px2=enlargement**2 * MIN_AREA_PX2,
        min_compactness=MIN_COMPACTNESS,
        rounded_share=ROUNDED_SHARE,
        side_end_weight=SIDE_END_WEIGHT,
        min_length_px=MIN_LENGTH_PX,
        min_crossing=MIN_CROSSING,
        min_side_px=MIN_QUAD_SIDE_PX,
        max_side_ratio=MAX_SIDE_RATIO,
        max_area_mismatch=MAX_AREA_MISMATCH,
        darker=DARKER,
        min_points=MIN_POINTS,
        smoothing_px=SMOOTHING_PX,
        sharpening_px=SHARPENING_PX,
        small_window_px=WINDOWS_PX[0],
        large_window_px=WINDOWS_PX[1],
        first_erosions=erosions.start,
        last_erosions=erosions.stop - 1,
        enlargement=enlargement,
    )
